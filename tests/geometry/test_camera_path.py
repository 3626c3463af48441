"""Cameras along a path."""

import math
from dataclasses import replace

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


def test_a_zoom_changes_evenly():
    (camera, _) = orbit(2)
    near = replace(camera, fx=2 * camera.fx, fy=2 * camera.fy, cx=camera.cx + 1)
    path = path_through([camera, near], 3)
    assert [one.fx for one in path] == pytest.approx([camera.fx, 1.5 * camera.fx, 2 * camera.fx])
    assert [one.cx for one in path] == pytest.approx([4.0, 4.5, 5.0])


def test_pictures_of_several_sizes_are_no_path():
    (camera, other) = orbit(2)
    with pytest.raises(InputError, match="pictures of one size, got 8 x 6 and 16 x 12; give a s"):
        path_through([camera, other.resized(16, 12)], 3)
