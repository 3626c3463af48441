"""Figures and pictures of the points of a state."""

import numpy as np
import torch

from pcore.evaluation.health import HEALTH, health_of, tinted_pixels
from pcore.geometry.camera import Camera


def above() -> Camera:
    pose = torch.eye(4)
    pose[2, 3] = 4.0
    return Camera.from_fov(pose, width=40, height=40, angle_x=0.4)


def floor() -> torch.Tensor:
    grid = torch.linspace(-0.5, 0.5, 40)
    flat = torch.cartesian_prod(grid, grid)
    return torch.cat([flat, torch.zeros(len(flat), 1)], dim=1)


def test_figures_of_a_half_seen_floor():
    points = floor()
    health = health_of(points, 2 * points, points[:, 0] < 0)
    alpha = torch.ones(40, 40)
    shown = health.shows_unseen(above(), alpha)
    assert shown is not None
    assert bool(shown[:, :18].all())
    assert not bool(shown[:, 22:].any())
    row = health.row(shown, alpha)
    assert set(row) == set(HEALTH)
    assert abs(row["unseen"] - 0.5) < 0.03
    assert abs(row["strain_99"] - 2) < 1e-5


def test_what_is_not_known_stays_empty():
    health = health_of(floor(), floor(), None)
    shown = health.shows_unseen(above(), torch.ones(40, 40))
    assert shown is None
    assert health.row(shown, torch.ones(40, 40))["unseen"] is None


def test_strain_in_colours_and_unseen_in_yellow():
    points = floor()
    pixels = health_of(points, 3 * points[:, [0, 1, 2]], None).strain_pixels(above())
    assert pixels.shape == (40, 40, 3)
    drawn = pixels[(pixels != 255).any(axis=-1)]
    assert len(drawn) > 100
    assert (drawn == [214, 38, 31]).all()
    mask = torch.zeros(4, 4, dtype=torch.bool)
    mask[0] = True
    tinted = tinted_pixels(torch.zeros(4, 4, 3), mask)
    assert np.array_equal(np.unique(tinted[1:]), [0])
    assert tinted[0, 0].tolist() == [125, 94, 3]
