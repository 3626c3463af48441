"""Files of cameras, depth and points, read back by other libraries."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from pcore.capture.load import load_cameras
from pcore.data.camera_output import save_colmap, save_transforms
from pcore.data.depth_files import depth_step, save_depth_png, save_exr
from pcore.data.points import save_painted
from pcore.errors import DependencyError, InputError
from pcore.geometry.orbit import orbit_cameras


def some_cameras(width: int = 32):
    cameras = orbit_cameras(
        torch.tensor([3.0, -2.0, 1.0]), 5.0, 3, elevation=0.4, width=width, height=24, angle_x=0.7
    )
    return [(f"view_{k}", camera) for k, camera in enumerate(cameras)]


def test_transforms_read_back(tmp_path: Path):
    named = some_cameras()
    save_transforms(tmp_path / "transforms.json", named)
    found = load_cameras(tmp_path / "transforms.json")
    assert [name for name, _ in found] == [name for name, _ in named]
    for (_, one), (_, other) in zip(named, found, strict=True):
        torch.testing.assert_close(other.world_from_camera, one.world_from_camera)
        assert (other.width, other.height) == (32, 24)
        assert other.fx == pytest.approx(one.fx)
    mixed = [*named[:1], ("wide", some_cameras(64)[1][1])]
    save_transforms(tmp_path / "mixed.json", mixed)
    assert [camera.width for _, camera in load_cameras(tmp_path / "mixed.json")] == [32, 64]


_READ = """
import json, sys
import pycolmap
model = pycolmap.Reconstruction(sys.argv[1])
out = {}
for image in model.images.values():
    camera = model.cameras[image.camera_id]
    pose = image.cam_from_world()
    place = pose * [3.3, -1.8, 1.2]
    out[image.name] = list(camera.img_from_cam(place))
print(json.dumps([out, len(model.points3D)]))
"""


def test_colmap_sees_points_where_cameras_do(tmp_path: Path):
    pytest.importorskip("pycolmap", reason="the extra for structure from motion is absent")
    named, point = some_cameras(), torch.tensor([[3.3, -1.8, 1.2]])
    save_colmap(tmp_path, named, torch.rand(5, 3), torch.rand(5, 3))
    # By itself: together with Pillow its wheel crashes.
    done = subprocess.run(
        [sys.executable, "-c", _READ, str(tmp_path)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    seen, points = json.loads(done.stdout.splitlines()[-1])
    assert points == 5
    for name, camera in named:
        column, row, _ = camera.project(point)
        assert seen[f"{name}.png"] == pytest.approx([float(column), float(row)], abs=1e-3)


def test_depth_of_16_bits_and_of_real_numbers(tmp_path: Path):
    depth = torch.tensor([[1.0, 2.5], [float("nan"), 3.9999]])
    step = depth_step(4.0)
    assert step == pytest.approx(1e-4)
    save_depth_png(tmp_path / "a.png", depth, step)
    stored = np.asarray(Image.open(tmp_path / "a.png"))
    assert stored.dtype == np.uint16
    np.testing.assert_allclose(stored * step, [[1.0, 2.5], [0.0, 3.9999]], atol=step / 2)
    assert depth_step(4000.0) == pytest.approx(0.1)
    exr = pytest.importorskip("OpenEXR", reason="the extra mesh is not installed")
    save_exr(tmp_path / "a.exr", Y=depth)
    with exr.File(str(tmp_path / "a.exr")) as file:
        planes = file.channels()["Y"].pixels
    np.testing.assert_array_equal(planes, [[1.0, 2.5], [np.inf, np.float32(3.9999)]])


def test_depth_that_cannot_be_written_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for farthest in (float("nan"), -1.0, 0.0, float("inf")):
        with pytest.raises(InputError, match="depth"):
            depth_step(farthest)
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(DependencyError, match="--no-exr"):
        save_exr(tmp_path / "a.exr", Y=torch.ones(2, 2))


def test_painted_points_read_back(tmp_path: Path):
    places, normals = torch.rand(7, 3), torch.nn.functional.normalize(torch.rand(7, 3), dim=1)
    colors, sure = torch.rand(7, 3), torch.rand(7)
    save_painted(tmp_path / "a.ply", places, colors, normals, sure)
    found = trimesh.load(tmp_path / "a.ply")
    np.testing.assert_allclose(found.vertices, places, atol=1e-6)
    np.testing.assert_allclose(found.colors[:, :3] / 255, colors, atol=0.003)
    raw = found.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_allclose(raw["confidence"].reshape(-1), sure, atol=1e-6)
    np.testing.assert_allclose(raw["nx"].reshape(-1), normals[:, 0], atol=1e-6)
    places[2, 1] = float("nan")
    with pytest.raises(InputError, match="finite"):
        save_painted(tmp_path / "b.ply", places, colors, normals, sure)
