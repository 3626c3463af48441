"""Points where photos agree: a textured wall is found again from its pictures."""

from __future__ import annotations

import torch
from torch import Tensor

from pcore.geometry.camera import Camera
from pcore.training.photo_consistency import consistent_points
from small_training import FakeView

WIDTH, HEIGHT = 40, 30


def painted(places: Tensor) -> Tensor:
    """Colours (..., 3) of a wall at z = 0."""
    x, y = places[..., 0], places[..., 1]
    waves = [torch.sin(7 * x + 3 * y), torch.sin(5 * y - 4 * x + 1), torch.cos(9 * x * y)]
    return 0.5 + 0.4 * torch.stack(waves, dim=-1)


def view_of_wall(shift: float) -> FakeView:
    pose = torch.eye(4)
    pose[:3, 3] = torch.tensor([shift, 0.5 * shift, 3.0])
    camera = Camera.from_fov(pose, width=WIDTH, height=HEIGHT, angle_x=0.8)
    rays = camera.rays()
    on_wall = rays.origins - rays.directions * (rays.origins[..., 2:] / rays.directions[..., 2:])
    pixels = torch.cat([painted(on_wall), torch.ones(HEIGHT, WIDTH, 1)], dim=-1)
    return FakeView(camera=camera, pixels=pixels, has_alpha=False)


def test_points_lie_on_a_wall_that_photos_show() -> None:
    views = [view_of_wall(0.25 * n) for n in range(-2, 3)]
    points = consistent_points(300, views, 1.0, 30.0, torch.Generator().manual_seed(0))
    assert 200 < len(points) <= 300
    # Depths come in steps of 5 % at the wall.
    assert float(points[:, 2].abs().median()) < 0.15
    assert float((points[:, 2].abs() < 0.3).float().mean()) > 0.65


def test_rays_that_nobody_else_sees_give_no_points() -> None:
    views = [view_of_wall(100.0 * n) for n in range(3)]
    points = consistent_points(50, views, 1.0, 5.0, torch.Generator().manual_seed(0))
    assert points.shape == (0, 3)
