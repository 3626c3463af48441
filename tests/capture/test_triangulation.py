"""Points for poses that came without: right ones fit the photos, wrong ones are told of."""

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from pcore.capture import triangulation
from pcore.capture.load import load_scene
from pcore.capture.reprojection import reprojection
from pcore.capture.scene_masks import ordered_views
from pcore.capture.triangulation import WRONG, Triangulated, triangulated
from pcore.errors import SceneError
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras

WIDTH, HEIGHT, COUNT = 200, 150, 8


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def texture() -> torch.Tensor:
    """(1, 1, 400, 400) grey spots of several sizes."""
    generator = torch.Generator().manual_seed(1)
    layers = [
        torch.nn.functional.interpolate(
            torch.rand(1, 1, size, size, generator=generator), (400, 400), mode="bicubic"
        )
        for size in (25, 60, 120)
    ]
    return (sum(layers) / len(layers)).clamp(0, 1)


def shot(camera: Camera) -> Image.Image:
    """A bowl-shaped ground z = 0.15 (x^2 + y^2) with spots, by steps along the rays."""
    rays = camera.rays()
    o, d = rays.origins, rays.directions
    t = -o[..., 2] / d[..., 2]
    for _ in range(20):
        p = o + t[..., None] * d
        t = t - (p[..., 2] - 0.15 * p[..., :2].square().sum(-1)) / d[..., 2]
    p = o + t[..., None] * d
    grey = torch.nn.functional.grid_sample(
        texture(), p[None, ..., :2] / 2.5, padding_mode="reflection", align_corners=False
    )[0, 0]
    return Image.fromarray((255 * grey).byte().numpy()).convert("RGB")


def capture(folder: Path, turn: float = 0.0) -> Path:
    """A transforms.json of right poses, or of poses turned by degrees, each about another axis."""
    (folder / "images").mkdir(parents=True)
    around = orbit_cameras(
        torch.zeros(3), 3.0, 3 * COUNT, elevation=0.9, width=WIDTH, height=HEIGHT, angle_x=0.9
    )[:COUNT]
    frames = []
    for number, camera in enumerate(around):
        shot(camera).save(folder / "images" / f"{number}.png")
        pose = camera.world_from_camera.double()
        angle = math.radians(turn) * (1 if number % 2 else -1)
        wrong = torch.eye(4, dtype=torch.float64)
        wrong[:2, :2] = torch.tensor(
            [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
        )
        frames.append(
            {"file_path": f"images/{number}.png", "transform_matrix": (pose @ wrong).tolist()}
        )
    content = {"w": WIDTH, "h": HEIGHT, "fl_x": around[0].focal[0], "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder


def points(folder: Path, factor: int = 1) -> Triangulated:
    return triangulated(load_scene(folder, factor=factor), lambda _: None)


@pytest.mark.skipif(
    triangulation.importlib.util.find_spec("pycolmap") is None, reason="pycolmap is not installed"
)
class TestWithColmap:
    def test_right_poses_give_points_on_the_surface(self, tmp_path: Path) -> None:
        found = points(capture(tmp_path / "bowl"), factor=2)
        assert found.agreement is not None
        assert found.agreement.median < 0.5
        assert found.agreement.doubtful() == ()
        sparse = found.scene.sparse
        assert sparse is not None
        assert len(sparse) > 50
        place = sparse.positions
        off = (place[:, 2] - 0.15 * place[:, :2].square().sum(-1)).abs()
        assert float(off.median()) < 0.01
        error = reprojection(sparse, ordered_views(found.scene))
        assert error is not None
        assert error.mean < 1

    def test_wrong_poses_are_told_of(self, tmp_path: Path) -> None:
        found = points(capture(tmp_path / "bowl", turn=4.0))
        assert found.agreement is not None
        assert found.agreement.median > WRONG


def test_what_was_found_is_kept_and_a_crash_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = capture(tmp_path / "bowl")
    monkeypatch.setattr(triangulation.importlib.util, "find_spec", lambda _: object())
    monkeypatch.setattr(triangulation, "CHILD", (sys.executable, "-c", "import os; os.abort()"))
    with pytest.raises(SceneError, match="found no points"):
        triangulated(load_scene(folder), lambda _: None)
    assert not list((tmp_path / "cache" / "pcore" / "structure").iterdir())


def test_distances_from_lines_are_zero_for_true_places_and_pixels_for_others() -> None:
    from pcore.capture.triangulation_child import from_line

    around = orbit_cameras(torch.zeros(3), 3.0, 6, elevation=0.4, width=80, height=60, angle_x=0.9)
    place = torch.rand(30, 3, generator=torch.Generator().manual_seed(0)).double() - 0.5
    flip = torch.diag(torch.tensor([1.0, -1.0, -1.0])).double()
    said, seen = [], []
    for camera in around[:2]:
        turn = flip @ camera.world_from_camera[:3, :3].double().T
        pose = torch.cat([turn, -(turn @ camera.center.double())[:, None]], 1)
        numbers = {"fx": camera.focal[0], "fy": camera.focal[1], "cx": 40.0, "cy": 30.0}
        said.append(numbers | {"camera_from_world": pose.tolist()})
        seen.append(torch.stack(camera.project(place)[:2], dim=-1).numpy())
    assert np.abs(from_line(seen[0], seen[1], *said)).max() < 1e-3
    # Off by 2 pixels in one picture, the nearest true pair is off by up to 2 / sqrt(2).
    off = from_line(seen[0], seen[1] + np.array([0.0, 2.0]), *said)
    assert 0.3 < float(np.median(off)) < 2
