"""The whole job in seconds: photos, pre-training, fine-tuning, a deformed picture."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from pcore.cli.main import main
from pcore.files.model_file import load_model
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras

SIZE = 16
ANGLE_X = 0.7
DISTANCE = 4.0
RADIUS = 0.8


def photo(camera: Camera) -> Image.Image:
    """A ball, red above and blue below."""
    rays = camera.rays()
    middle = (rays.origins * rays.directions).sum(dim=-1)
    inside = middle.square() - rays.origins.square().sum(dim=-1) + RADIUS**2
    along = -middle - inside.clamp_min(0).sqrt()
    red = (rays.origins[..., 2] + along * rays.directions[..., 2] > 0).float()
    rgba = torch.stack([red, torch.zeros_like(red), 1 - red, (inside > 0).float()], dim=-1)
    return Image.fromarray((rgba * 255).to(torch.uint8).numpy())


def write_scene(root: Path) -> Path:
    for split, count, elevation in (("train", 20, 0.5), ("test", 2, 0.45)):
        (root / split).mkdir(parents=True)
        cameras = orbit_cameras(
            torch.zeros(3),
            DISTANCE,
            count,
            elevation=elevation,
            width=SIZE,
            height=SIZE,
            angle_x=ANGLE_X,
        )
        frames = []
        for index, camera in enumerate(cameras):
            photo(camera).save(root / split / f"r_{index}.png")
            pose = camera.world_from_camera.tolist()
            frames.append({"file_path": f"./{split}/r_{index}", "transform_matrix": pose})
        content = {"camera_angle_x": ANGLE_X, "frames": frames}
        (root / f"transforms_{split}.json").write_text(json.dumps(content))
    return root


@pytest.mark.timeout(120)
def test_from_photos_to_a_deformed_picture(tmp_path: Path) -> None:
    scene, run, out = write_scene(tmp_path / "ball"), tmp_path / "run", tmp_path / "pictures"
    cpu = ["--device", "cpu", "--threads", "1"]
    train = ["train", str(scene), "-o", str(run), "--steps", "300", "--points", "300", *cpu]
    assert main(train) == 0
    assert main(["finetune", str(run), "--steps", "5", *cpu]) == 0
    edit = tmp_path / "large.json"
    edit.write_text('{"version": 1, "edits": [{"type": "scale", "factor": 1.3}]}')
    tuned = tmp_path / "run-pcore"
    render = ["render", str(tuned), "--split", "test", "--raw", "--normals", *cpu]
    assert main([*render, "-o", str(out / "plain")]) == 0
    assert main([*render, "-o", str(out / "large"), "--edit", str(edit)]) == 0

    assert load_model(tuned).provenance.stage == "finetune"
    with np.load(out / "plain" / "r_1.npz") as plain, np.load(out / "large" / "r_1.npz") as large:
        # Even so little training finds the ball in its place; the edit makes it larger.
        ball, larger = plain["alpha"] > 0.5, large["alpha"] > 0.5
        assert 50 < int(ball.sum()) < 110
        assert int(larger.sum()) > 1.2 * int(ball.sum())
        assert np.abs(plain["depth"][ball] - DISTANCE).max() < RADIUS
        # Planes over 300 points, seen by pixels as wide as those are apart, stick out at the rim.
        far = np.linalg.norm(plain["surface"][ball], axis=-1)
        assert far.max() < 1.2 * RADIUS
        assert abs(np.median(far) - RADIUS) < 0.1 * RADIUS
        reach = np.linalg.norm(large["surface"][larger], axis=-1)
        assert abs(np.median(reach) - 1.3 * RADIUS) < 0.13 * RADIUS
        assert 1.1 * RADIUS < reach.max() < 1.3 * 1.2 * RADIUS
        red, _, blue = plain["rgb"][4, 8]
        assert red > blue + 0.3
        red, _, blue = plain["rgb"][11, 8]
        assert blue > red + 0.3
