"""Poses that photos of one object cannot have, and places that single precision cannot hold."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pcore.capture.load import load_scene
from pcore.data.poses import check_poses
from pcore.errors import SceneError
from pcore.geometry.camera import Camera
from scene_files import pose, write_split

OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
UTM = (512345.0, 5412345.0, 432.0)


def orbit(count: int = 8, *, at: tuple[float, ...] = (0.0, 0.0, 0.0), radius: float = 4.0):
    """Camera-to-world matrices (count, 4, 4) around a place."""
    poses = np.array([pose(0.8 * i, 0.4 - 0.1 * (i % 8), radius) for i in range(count)])
    poses[:, :3, 3] += at
    return poses


def look(poses: np.ndarray) -> str:
    """What `check_poses` notes."""
    cameras = [
        Camera.from_fov(torch.eye(4), width=12, height=8, angle_x=0.7) for _ in range(len(poses))
    ]
    names = [f"r_{i}" for i in range(len(poses))]
    return check_poses(torch.from_numpy(poses), cameras, names, "scene file x.json")


def write(root: Path, poses: np.ndarray, **keys: Any) -> Path:
    """A scene of these poses."""
    path = write_split(root, "train", count=len(poses))
    content = json.loads(path.read_text())
    for frame, matrix in zip(content["frames"], poses.tolist(), strict=True):
        frame["transform_matrix"] = matrix
    path.write_text(json.dumps({**content, **keys}))
    return root


# --- matrices of another kind (faults/25 and kin) -----------------------------------------------


def in_centimetres(poses: np.ndarray) -> np.ndarray:
    poses = poses.copy()
    poses[:, :3, 3] *= 100
    return poses


WRONG = {
    "world-to-camera": np.linalg.inv(orbit()),
    "world-to-camera, float32 text": np.linalg.inv(orbit()).astype(np.float32).astype(np.float64),
    "world-to-camera, six decimals": np.linalg.inv(orbit()).round(6),
    "world-to-camera, in centimetres": np.linalg.inv(in_centimetres(orbit())),
    "world-to-camera, object aside": np.linalg.inv(orbit(at=(3.0, -2.0, 1.0))),
    "OpenCV axes": orbit() @ OPENCV,
    "OpenCV axes, object aside": orbit(at=(3.0, -2.0, 1.0)) @ OPENCV,
    "world-to-camera, OpenCV axes (COLMAP)": np.linalg.inv(orbit() @ OPENCV),
}
LEVEL = np.array([pose(0.8 * i) for i in range(8)])
"""A turntable: read as camera-to-world, the axes of its world-to-camera matrices are parallel."""


@pytest.mark.parametrize("kind", WRONG)
def test_matrices_of_another_kind_are_named(kind: str) -> None:
    with pytest.raises(SceneError) as caught:
        look(WRONG[kind])
    message = str(caught.value)
    assert "no view sees the point" in message or "views see the point" in message
    assert "check that poses are camera-to-world, OpenGL axes" in message
    assert "subtract" not in message
    inverted = "world-to-camera" in kind
    assert f"Read as {'world-to-camera' if inverted else 'camera-to-world with OpenCV'}" in message


@pytest.mark.parametrize("poses", [np.linalg.inv(LEVEL), np.linalg.inv(LEVEL @ OPENCV)])
def test_matrices_of_a_turntable_are_named_too(poses: np.ndarray) -> None:
    with pytest.raises(SceneError, match=r"axes of all 8 views are parallel; check that poses are"):
        look(poses)


def test_a_scene_of_world_to_camera_matrices_is_not_loaded(tmp_path: Path) -> None:
    write(tmp_path, np.linalg.inv(orbit()))
    with pytest.raises(SceneError, match=r"no view sees the point .* that poses are camera-to-wor"):
        load_scene(tmp_path)


def test_some_views_that_look_away_are_told_of() -> None:
    poses = orbit()
    poses[[2, 5]] = poses[[2, 5]] @ OPENCV
    assert look(poses).startswith("2 of 8 views do not see the point")
    assert "(r_2, r_5)" in look(poses)


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (3.0, -2.0, 1.0), (90.0, 0.0, -20.0)])
@pytest.mark.parametrize("radius", [4e-3, 0.4, 4.0, 4e3])
def test_good_poses_have_no_notes(at: tuple[float, ...], radius: float) -> None:
    assert look(orbit(at=tuple(radius / 4 * x for x in at), radius=radius)) == ""


def test_views_from_one_side_and_single_views_have_no_notes() -> None:
    assert look(orbit(1)) == ""
    assert look(np.array([pose(0.0), pose(0.01)])) == ""
    row = np.array([pose(0.0)] * 3)
    row[:, 1, 3] += [0.0, 0.1, 0.2]
    assert look(row) == ""  # Parallel axes are refused when the object's place is asked for.


def test_test_views_may_stand_still(tmp_path: Path) -> None:
    # A film of a moving object from one place.
    write(tmp_path, orbit())
    path = write_split(tmp_path, "test", count=2)
    content = json.loads(path.read_text())
    content["frames"][1]["transform_matrix"] = content["frames"][0]["transform_matrix"]
    path.write_text(json.dumps(content))
    assert len(load_scene(tmp_path).split("test")) == 2


# --- single precision (faults/05 and kin) -------------------------------------------------------

EARTH = (3_912_345.0, 812_345.0, 4_954_321.0)


@pytest.mark.parametrize(
    ("at", "radius"),
    [
        (UTM, 4.0),
        (tuple(1000 * x for x in UTM), 4000.0),  # in millimetres
        (EARTH, 4.0),  # ECEF
        (EARTH, 40.0),  # a drone
        ((0.0, 0.0, 1e6), 2.0),
        ((-20_037_508.0, 4_500_000.0, 0.0), 5.0),  # web mercator
    ],
)
def test_places_far_from_the_origin_are_refused_with_the_offset(
    at: tuple[float, ...], radius: float
) -> None:
    with pytest.raises(SceneError) as caught:
        look(orbit(16, at=at, radius=radius))
    message = str(caught.value)
    assert "expected a scene near the origin" in message
    offset = json.loads(message.split("subtract ")[1].split("]")[0] + "]")
    assert np.abs(np.array(offset) - at).max() < radius
    assert all(isinstance(value, int) for value in offset)
    assert "add it to what pcore exports" in message


def test_the_remedy_works(tmp_path: Path) -> None:
    far = orbit(at=UTM)
    with pytest.raises(SceneError, match=r"subtract \[") as caught:
        load_scene(write(tmp_path / "far", far))
    offset = json.loads(str(caught.value).split("subtract ")[1].split("]")[0] + "]")
    near = far.copy()
    near[:, :3, 3] -= offset
    loaded = load_scene(write(tmp_path / "near", near))
    # Double precision: nothing of the place of the cameras is lost, not even their millionths.
    assert loaded.radius == pytest.approx(load_scene(write(tmp_path / "o", orbit())).radius)
    assert loaded.notes == ()


def test_a_distance_that_costs_a_little_is_told_of() -> None:
    note = look(orbit(at=(0.0, 1500.0, 0.0)))
    assert "the cameras stand about [" in note
    assert "to lose nothing, subtract [" in note
    assert look(orbit(at=(0.0, 300.0, 0.0))) == ""


def test_cameras_are_rounded_once(tmp_path: Path) -> None:
    at = (1234.567891234, -987.654321, 55.5)
    loaded = load_scene(write(tmp_path, orbit(at=at)))
    center = loaded.split("train")[0].camera.center.double().numpy()
    expected = orbit(at=at)[0, :3, 3]
    assert np.abs(center - expected).max() <= math.ulp(1240) * 2**29
