"""Where a camera sees points: the other way round from its rays."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.rotation import rotations


def turned() -> Camera:
    """No square pixels, no middle in the middle, no axis along the world's."""
    angle = 0.7
    turn = torch.tensor(
        [
            [math.cos(angle), 0.0, math.sin(angle)],
            [0.0, 1.0, 0.0],
            [-math.sin(angle), 0.0, math.cos(angle)],
        ]
    )
    tilt = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])
    pose = torch.eye(4)
    pose[:3, :3], pose[:3, 3] = turn @ tilt, torch.tensor([1.0, -2.0, 3.0])
    return Camera(width=7, height=5, fx=9.0, fy=11.0, cx=3.1, cy=2.2, world_from_camera=pose)


def test_a_rectangle_without_pixels_has_no_rays() -> None:
    assert turned().rays(top=2, height=0).shape == (0, 7)
    assert turned().rays(left=2, width=0).shape == (5, 0)
    assert turned().rays(top=2).shape == (3, 7)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_points_on_the_rays_of_pixels_are_seen_there(dtype: torch.dtype) -> None:
    camera = turned()
    rays = camera.rays().flat()
    distance = torch.linspace(0.5, 4.0, 35)[:, None]
    points = (rays.origins + distance * rays.directions).to(dtype)
    column, row, depth = camera.project(points)
    rows, columns = torch.meshgrid(torch.arange(5), torch.arange(7), indexing="ij")
    torch.testing.assert_close(column, columns.flatten().to(dtype) + 0.5, rtol=0, atol=1e-4)
    torch.testing.assert_close(row, rows.flatten().to(dtype) + 0.5, rtol=0, atol=1e-4)
    torch.testing.assert_close(depth, camera.depth(points))
    assert bool((camera.project(2 * camera.center.to(dtype) - points)[2] < 0).all())


def test_a_viewers_camera_is_ours():
    position, fov, wxyz = torch.tensor([1.0, -2.0, 0.5]), 0.8, torch.tensor([0.3, -0.7, 0.2, 0.6])
    camera = Camera.from_view(position, wxyz, fov, width=320, height=200)
    turn = rotations(wxyz)  # world_from_camera of OpenCV axes
    ahead = position + 3 * turn[:, 2]
    column, row, depth = camera.project(
        torch.stack([ahead, ahead + turn[:, 0], ahead + turn[:, 1]])
    )
    torch.testing.assert_close(depth, torch.full((3,), 3.0))
    assert abs(float(column[0]) - 160) < 1e-3
    assert float(column[1]) > 160
    assert float(row[2]) > 100  # y is down
    top = position + turn @ torch.tensor([0.0, -math.tan(0.4), 1.0])
    assert abs(float(camera.project(top.unsqueeze(0))[1])) < 1e-3
    with pytest.raises(InputError, match="vertical field of view"):
        Camera.from_view(position, wxyz, 0.0, width=4, height=4)


def test_a_cropped_camera_sees_the_rectangle():
    camera = Camera.from_view(
        torch.zeros(3), torch.tensor([1.0, 0, 0, 0]), 1.0, width=20, height=10
    )
    whole, part = camera.rays(), camera.cropped(4, 3, 8, 5).rays()
    torch.testing.assert_close(part.directions, whole.directions[3:8, 4:12])


def test_a_batch_sees_points_as_its_cameras_do() -> None:
    first = turned()
    pose = first.world_from_camera.clone()
    pose[:3, :3] = pose[:3, [1, 2, 0]]
    second = replace(first.moved(pose), fx=12.0, cx=2.0)
    points = first.rays().at(torch.full((5, 7), 2.0)).reshape(-1, 3)
    seen = Camera.stack([first, second]).project(points)
    for found, *alone in zip(seen, first.project(points), second.project(points), strict=True):
        assert torch.equal(found, torch.stack(alone))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"world_from_camera": np.eye(4)}, "expected a tensor of float32 or float64, got ndarray"),
        ({"world_from_camera": torch.eye(4).long()}, r"got one of torch\.int64; make one with"),
        ({"width": 7.5}, r"positive image size, got 7\.5 x 5"),
        ({"height": 0}, "positive image size, got 7 x 0"),
        ({"cx": math.nan}, "finite principal point in pixels, got nan"),
        ({"fy": math.inf}, "positive focal lengths in pixels"),
    ],
)
def test_what_makes_no_camera(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(turned(), **changes)
