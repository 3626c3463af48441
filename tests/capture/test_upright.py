"""The world of poses that nobody gave one: upright, at the origin, whatever COLMAP left."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcore.capture.upright import DISTANCE, Similarity, upright


def looking(eye: np.ndarray, at: np.ndarray, roll: float = 0.0) -> np.ndarray:
    """A pose (4, 4), OpenGL axes, of a camera that is held level but for a roll in degrees."""
    back = (eye - at) / np.linalg.norm(eye - at)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    axes = np.stack([right, np.cross(back, right), back], axis=1)
    pose[:3, :3] = axes @ Rotation.from_euler("z", roll, degrees=True).as_matrix()
    pose[:3, 3] = eye
    return pose


def walk(
    degrees: float, elevation: float, count: int = 24, at: tuple[float, ...] = (5.0, -3.0, 2.0)
) -> np.ndarray:
    """Poses (N, 4, 4) on a part of a circle around a place, with hands that shake by 3 degrees."""
    random, place = np.random.default_rng(0), np.array(at)
    poses = []
    for k in range(count):
        turn, rise = np.radians(degrees * k / count), np.radians(elevation)
        away = np.array(
            [np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)]
        ) * random.uniform(1.8, 2.2)
        poses.append(looking(place + away, place, random.normal(0, 3)))
    return np.stack(poses)


def put(similarity: Similarity, places: np.ndarray) -> np.ndarray:
    return similarity.scale * places @ similarity.rotation.T + similarity.translation


@pytest.mark.parametrize(("degrees", "elevation"), [(360, 30), (360, -10), (80, 45)])
def test_the_object_stands_at_the_origin(degrees: float, elevation: float) -> None:
    poses = walk(degrees, elevation)
    found = upright(poses)
    up = found.rotation @ [0.0, 0.0, 1.0]
    assert np.degrees(np.arccos(up[2])) < 3
    assert np.allclose(put(found, np.array([5.0, -3.0, 2.0])), 0, atol=1e-9)
    places = put(found, poses[:, :3, 3])
    assert np.median(np.linalg.norm(places, axis=1)) == pytest.approx(DISTANCE)
    # The first camera stands before it and looks along +y.
    assert abs(places[0, 0]) < 1e-9
    assert places[0, 1] < 0


@pytest.mark.parametrize("seed", range(6))
def test_photos_taken_straight_down_have_the_floor_below(seed: int) -> None:
    """Tops of pictures lie in the floor, whichever way the hands lean: up is where they are."""
    random = np.random.default_rng(seed)
    poses = []
    for turn in np.linspace(0, 2 * np.pi, 24, endpoint=False):
        pose = np.eye(4)
        shake = Rotation.from_rotvec(random.normal(0, 0.04, 3))
        pose[:3, :3] = (Rotation.from_euler("z", turn) * shake).as_matrix()
        pose[:3, 3] = [*random.normal(0, 0.3, 2), 3.0]
        poses.append(pose)
    up = upright(np.stack(poses)).rotation @ [0.0, 0.0, 1.0]
    assert np.degrees(np.arccos(up[2])) < 5


def test_what_colmap_left_does_not_matter() -> None:
    """Two worlds of the same photos become one."""
    poses, places = walk(200, 25), np.random.default_rng(1).normal(size=(9, 3))
    turn, shift, scale = Rotation.random(random_state=2).as_matrix(), np.array([7.0, 1, -4]), 0.03
    other = poses.copy()
    other[:, :3, :3] = turn @ poses[:, :3, :3]
    other[:, :3, 3] = scale * poses[:, :3, 3] @ turn.T + shift
    here, there = upright(poses), upright(other)
    assert np.allclose(put(here, places), put(there, scale * places @ turn.T + shift), atol=1e-6)


def test_cameras_that_tell_little_are_still_given_a_world() -> None:
    above = np.stack([looking(np.array([x, 1e-9, 4.0]), np.array([x, 0, 0])) for x in (0.0, 0.3)])
    for poses in (above, above[:1], np.stack([np.eye(4)] * 3)):
        found = upright(poses)
        assert np.allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(found.rotation) == pytest.approx(1)
        assert np.isfinite(found.translation).all()
        assert found.scale > 0
