"""Axes that turn along with a capture."""

import math

import pytest
import torch

from pcore.capture.coverage import coverage
from pcore.geometry.camera import Camera
from pcore.geometry.capture_axes import capture_axes
from pcore.geometry.orbit import orbit_cameras


def orbit() -> list[Camera]:
    return orbit_cameras(torch.zeros(3), 4.0, 8, elevation=0.5, width=8, height=8, angle_x=0.7)


@pytest.mark.parametrize("degrees", [40, 90, 180, 270])
def test_a_walk_on_one_side_that_looks_down_is_upright(degrees: int) -> None:
    """Its upward axes lean to the object, all to one side: by 10 to 45 degrees in the mean."""
    ring = orbit_cameras(torch.zeros(3), 4.0, 72, elevation=0.8, width=8, height=8, angle_x=0.7)
    walked = ring[: degrees // 5]
    assert float(capture_axes(walked)[2, 2]) > 0.9999
    found = coverage(walked, torch.zeros(3))
    assert found.gap == pytest.approx(365 - degrees, abs=0.1)
    torch.testing.assert_close(found.elevation, torch.full((len(walked),), math.degrees(0.8)))


def turned(camera: Camera, turn: torch.Tensor) -> Camera:
    pose = camera.world_from_camera.clone()
    pose[:3] = turn @ pose[:3]
    return camera.moved(pose)


def test_they_are_upright_and_turn_along() -> None:
    axes = capture_axes(orbit())
    torch.testing.assert_close(axes.T @ axes, torch.eye(3))
    assert float(torch.linalg.det(axes)) > 0
    torch.testing.assert_close(axes[:, 2], torch.tensor([0.0, 0.0, 1.0]))
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1)))[0]
    turn = turn * torch.linalg.det(turn)
    moved = capture_axes([turned(camera, turn) for camera in orbit()])
    torch.testing.assert_close(moved, turn @ axes)


def test_cameras_any_way_up() -> None:
    """Two whose upward axes cancel, and one that is rolled by a quarter among upright ones."""
    half = torch.diag(torch.tensor([-1.0, -1.0, 1.0]))
    camera = orbit()[0]
    rolled = camera.world_from_camera.clone()
    rolled[:3, :3] = rolled[:3, :3] @ half
    quarter = camera.world_from_camera.clone()
    quarter[:3, :3] = quarter[:3, :3] @ torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for cameras in ([camera, camera.moved(rolled)], [camera.moved(quarter), *[camera] * 9]):
        axes = capture_axes(cameras)
        torch.testing.assert_close(axes.T @ axes, torch.eye(3))
