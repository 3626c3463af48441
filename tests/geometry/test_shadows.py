"""Shadow maps made of points."""

from __future__ import annotations

import pytest
import torch

from pcore.geometry.shadows import unshadowed
from pcore.training.light_fit import sphere

UP = torch.tensor([[0.0, 0.0, 1.0]])
STEP = 0.05


def plate(height: float, side: int = 40) -> torch.Tensor:
    """A square grid (side * side, 3) around the z axis."""
    steps = (torch.arange(side) - (side - 1) / 2) * STEP
    grid = torch.cartesian_prod(steps, steps)
    return torch.cat([grid, torch.full((side * side, 1), height)], dim=1)


def test_a_lid_hides_what_is_below_it_from_above_only() -> None:
    points = torch.cat([plate(0.0), plate(1.0, side=20)])
    found = unshadowed(points, torch.cat([UP, -UP]), STEP)
    assert found.shape == (2000, 2)
    flat = points[:1600, :2].abs().amax(dim=1)
    above = found[:1600, 0]
    assert (above[flat < 0.45] == 0).all()
    assert (above[flat > 0.6] == 1).all()
    assert (found[1600:, 0] == 1).all(), "nothing is above the lid"
    assert (found[:1600, 1] == 1).all()
    assert (found[1600:, 1] == 0).all()


def test_the_edge_of_a_shadow_is_soft() -> None:
    points = torch.cat([plate(0.0), plate(1.0, side=20)])
    above = unshadowed(points, UP, STEP)[:1600, 0]
    between = (above > 0) & (above < 1)
    assert between.any()
    assert (points[:1600][between, :2].abs().amax(dim=1) - 0.5).abs().max() < 2.5 * STEP


def test_shadows_fall_away_from_the_light() -> None:
    """A lid that is as high as it is far to the side, under a light from 45 degrees."""
    lid = plate(1.0, side=20)
    slanted = torch.nn.functional.normalize(torch.tensor([[1.0, 0.0, 1.0]]), dim=1)
    lid[:, 0] += 1.0
    found = unshadowed(torch.cat([plate(0.0), lid]), slanted, STEP)[:1600, 0]
    middle = plate(0.0)[:, :2].abs().amax(dim=1) < 0.4
    assert (found[middle] == 0).all()
    mirrored = slanted * torch.tensor([[-1.0, 1.0, 1.0]])
    assert (unshadowed(torch.cat([plate(0.0), lid]), mirrored, STEP)[:1600, 0][middle] == 1).all()


def test_a_shell_as_thick_as_points_lie_does_not_hide_itself() -> None:
    points = sphere(4000) * (1 + 0.02 * torch.randn(4000, 1))
    spacing = 0.06
    directions = sphere(30)
    found = unshadowed(points, directions, spacing)
    facing = points @ directions.T
    assert float(found[facing > 0.5].mean()) > 0.97
    assert float(found[facing < -0.5].mean()) < 0.03


@pytest.mark.parametrize("scale", [0.25, 4.0])
def test_sizes_and_places_do_not_matter(scale: float) -> None:
    points = torch.cat([plate(0.0), plate(1.0, side=20)])
    directions = sphere(20)
    expected = unshadowed(points, directions, STEP)
    found = unshadowed(scale * points, directions, scale * STEP)
    assert torch.equal(found, expected)
    moved = unshadowed(points + torch.tensor([4.0, -8.0, 2.0]), directions, STEP)
    assert float((moved - expected).abs().mean()) < 1e-3


def test_batches_of_directions_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    points, directions = torch.randn(300, 3), sphere(25)
    expected = unshadowed(points, directions, 0.2)
    monkeypatch.setattr("pcore.geometry.shadows._ELEMENTS", 1)
    assert torch.equal(unshadowed(points, directions, 0.2), expected)


def test_points_without_a_spacing_hide_nothing() -> None:
    for points in (torch.zeros(1, 3), torch.ones(5, 3), torch.randn(5, 3)):
        assert (unshadowed(points, UP, 0.0) == 1).all()


def test_what_is_less_deep_than_a_surface_is_thick_is_lit() -> None:
    for spacings, share in ((2.5, 1.0), (5.0, 0.0)):
        points = torch.cat([plate(0.0), plate(spacings * STEP, side=20)])
        found = unshadowed(points, UP, STEP)[:1600, 0]
        assert (found[points[:1600, :2].abs().amax(dim=1) < 0.4] == share).all()


def test_maps_have_no_more_cells_than_that(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a stray point far away a lid lies within the surface of a coarse map."""
    points = torch.cat([plate(0.0), plate(1.0, side=20)])
    far = torch.cat([points, torch.tensor([[1e3, 0.0, 0.0]])])
    middle = points[:1600, :2].abs().amax(dim=1) < 0.4
    assert (unshadowed(points, UP, STEP)[:1600, 0][middle] == 0).all()
    monkeypatch.setattr("pcore.geometry.shadows._FINEST", 64)
    assert (unshadowed(far, UP, STEP)[:1600, 0][middle] == 1).all()


def test_a_stray_point_makes_maps_coarse_and_nothing_dark(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slope that lies in one cell does not hide itself."""
    monkeypatch.setattr("pcore.geometry.shadows._FINEST", 64)
    slope = plate(0.0)
    slope[:, 2] = slope[:, 0]
    points = torch.cat([slope, torch.tensor([[1e4, 0.0, 0.0]])])
    assert (unshadowed(points, UP, STEP)[:1600] == 1).all()
