"""The whole job in seconds: photos, pre-training, fine-tuning, a deformed picture."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from PIL import Image

from pcore.cli.main import main
from pcore.files.model_file import load_model
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras

Array = NDArray[Any]
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


FACTOR = 1.3


def cameras(count: int, elevation: float, distance: float = DISTANCE) -> list[Camera]:
    return orbit_cameras(
        torch.zeros(3),
        distance,
        count,
        elevation=elevation,
        width=SIZE,
        height=SIZE,
        angle_x=ANGLE_X,
    )


def write_cameras(path: Path, seen: list[Camera], folder: str) -> None:
    frames = [
        {"file_path": f"./{folder}/r_{i}", "transform_matrix": one.world_from_camera.tolist()}
        for i, one in enumerate(seen)
    ]
    path.write_text(json.dumps({"camera_angle_x": ANGLE_X, "frames": frames}))


def write_scene(root: Path) -> Path:
    for split, count, elevation in (("train", 20, 0.5), ("test", 2, 0.45)):
        (root / split).mkdir(parents=True)
        seen = cameras(count, elevation)
        for index, camera in enumerate(seen):
            photo(camera).save(root / split / f"r_{index}.png")
        write_cameras(root / f"transforms_{split}.json", seen, split)
    return root


def learned_pictures(folder: Path, seed: int = 0) -> Path:
    """Train, fine-tune and draw; returns the folder with those of views, scaled and from nearer.

    "near" shows the object as it is to cameras moved towards it by what "large" is scaled by.
    """
    scene, run, out = write_scene(folder / "ball"), folder / "run", folder / "pictures"
    edit, near = folder / "large.json", folder / "near.json"
    edit.write_text(json.dumps({"version": 2, "edits": [{"type": "scale", "factor": FACTOR}]}))
    write_cameras(near, cameras(2, 0.45, DISTANCE / FACTOR), "near")
    cpu = ["--device", "cpu"]
    train = ["train", str(scene), "-o", str(run), "--model", "papr", "--steps", "300", *cpu]
    train += ["--points", "300"]
    assert main([*train, "--seed", str(seed)]) == 0
    assert main(["finetune", str(run), "--steps", "5", *cpu]) == 0
    tuned, views = folder / "run-pcore", ["--split", "test"]
    assert load_model(tuned).provenance.stage == "finetune"
    for name, options in {
        "plain": views,
        "large": [*views, "--edit", str(edit)],
        "near": ["--cameras", str(near), "--size", str(SIZE), str(SIZE)],
    }.items():
        render = ["render", str(tuned), "--raw", "--normals", "-o", str(out / name)]
        assert main([*render, *options, *cpu]) == 0
    return out


@pytest.mark.learned
@pytest.mark.timeout(600)
def test_from_photos_to_a_deformed_picture(tmp_path: Path) -> None:
    """Bounds come from what is given with each.

    That is the spread over 8 seeds, and fewer of them with 1 and 2 threads and kernels for all
    processors, AVX2 and AVX-512: 2 views each.
    """
    out = learned_pictures(tmp_path)
    for view in ("r_0.npz", "r_1.npz"):
        with np.load(out / "plain" / view) as plain:
            ball = plain["alpha"] > 0.5
            far = np.linalg.norm(plain["surface"][ball], axis=-1) / RADIUS
            near = np.abs(plain["depth"][ball] - DISTANCE) / RADIUS
            rgb = plain["rgb"]
        # Even so little training finds the ball in its place: 58 to 62 pixels.
        assert 45 < int(ball.sum()) < 80
        # The median lies at 0.93 to 0.96. Planes over 300 points, seen by pixels as wide as those
        # are apart, stick out at the rim: 1.05 to 1.19.
        assert abs(np.median(far) - 1) < 0.15
        assert far.max() < 1.5
        # The front, 0.97 to 1.02 radii nearer than the middle.
        assert 0.8 < near.max() < 1.2
        # Differences of 0.86 to 1.07.
        assert rgb[4, 8, 0] - rgb[4, 8, 2] > 0.3
        assert rgb[11, 8, 2] - rgb[11, 8, 0] > 0.3
        # Whatever was learned, larger is nearer.
        with np.load(out / "large" / view) as large, np.load(out / "near" / view) as nearer:
            assert_same_but_for_scale(large, nearer)
            assert int((large["alpha"] > 0.5).sum()) > 1.2 * int(ball.sum())


def assert_same_but_for_scale(large: Mapping[str, Array], near: Mapping[str, Array]) -> None:
    """A scaled object is the object seen from nearer, and so many times as deep.

    Up to rounding, but where neighbours are equally near to a ray, or planes equally good for it:
    there it jumps. In the spread at most 3 of 121 pixels did, by 1.3e-3 in alpha and by 0.085 in
    places; all others were alike to 1e-6, colours to 2e-3.
    """
    seen = large["alpha"] > 0.5
    for name, factor, rounding, jump in (
        ("alpha", 1.0, 1e-4, 0.05),
        ("rgb", 1.0, 5e-3, 0.05),
        ("depth", FACTOR, 1e-3, RADIUS),
        ("surface", FACTOR, 1e-3, RADIUS),
    ):
        off = np.abs(large[name] - factor * near[name]).reshape(*seen.shape, -1).max(axis=-1)[seen]
        assert np.mean(off > rounding) < 0.08, name
        assert off.max() < jump, name
