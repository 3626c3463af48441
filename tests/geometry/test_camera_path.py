"""Cameras along a path."""

import math

import pytest
import torch

from pcore.errors import InputError
from pcore.geometry.camera_path import path_through
from pcore.geometry.orbit import orbit_cameras


def orbit(count: int) -> list:
    return orbit_cameras(torch.zeros(3), 4.0, count, elevation=0.0, width=8, height=6, angle_x=0.7)


def test_the_given_cameras_are_on_the_path():
    given = orbit(6)[:3]
    path = path_through(given, 5)
    for number, camera in zip((0, 2, 4), given, strict=True):
        torch.testing.assert_close(
            path[number].world_from_camera, camera.world_from_camera, rtol=0, atol=1e-6
        )
    assert path[1].width == 8


def test_between_two_cameras_it_turns_evenly():
    first, second = orbit(4)[:2]
    between = path_through([first, second], 3)[1]
    torch.testing.assert_close(between.center, 0.5 * (first.center + second.center))
    turn = first.world_from_camera[:3, :3].T @ between.world_from_camera[:3, :3]
    assert math.acos((float(turn.trace()) - 1) / 2) == pytest.approx(math.pi / 4, abs=1e-3)


def test_one_camera_stands():
    (camera, _) = orbit(2)
    assert path_through([camera], 3) == [camera] * 3
    with pytest.raises(InputError, match="expected at least one camera and one frame, got 0"):
        path_through([], 3)
