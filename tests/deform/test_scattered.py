"""Space that goes along with scattered points."""

import pytest
import torch

from pcore.deform.base import Compose
from pcore.deform.scattered import PointMotion, Scattered, motion_slopes, scalar_slopes
from pcore.deform.simple import rigid, uniform_scale
from pcore.errors import InputError

MOTION = Compose(rigid((1, 2, 3), 2.5, (0.3, 0, 0)), uniform_scale(1.3))


def sheet(count: int = 600, seed: int = 0) -> torch.Tensor:
    """Points on a flat square, which say nothing about the direction across it."""
    flat = torch.rand(count, 3, generator=torch.Generator().manual_seed(seed)).double()
    return flat * torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64)


def filled(count: int = 600, seed: int = 0) -> torch.Tensor:
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(seed)).double()


@pytest.mark.parametrize("make", [sheet, filled])
def test_a_similarity_is_found_also_on_a_sheet(make):
    points = make()
    linear = motion_slopes(points, MOTION(points))
    expected = MOTION.jacobian(points)
    # Across a sheet, only the turn is known, not the scale.
    size = torch.tensor([1.0, 1.0, 1.0]).double()
    if make is sheet:
        size[2] = 1 / 1.3
    torch.testing.assert_close(linear, expected * size, rtol=0, atol=5e-3)
    assert bool((torch.linalg.det(linear) > 0.9).all())


def test_exact_at_the_points_in_value_and_slope():
    points = filled()
    after = points + 0.1 * torch.sin(3 * points)
    motion = PointMotion(points, after)
    assert torch.equal(motion(points), after)
    torch.testing.assert_close(motion.jacobian(points), motion.field.slopes, rtol=1e-9, atol=1e-9)
    single = points.float()
    assert torch.equal(PointMotion(single, after.float())(single), after.float())


def test_a_place_does_not_know_its_company():
    points = filled()
    motion = PointMotion(points, points + 0.1 * torch.sin(3 * points))
    places = filled(100, seed=5)
    together = motion(places)
    for number in (0, 50, 99):
        assert torch.equal(motion(places[number]), together[number])


def test_between_points_it_agrees_with_a_smooth_map():
    places = 0.1 + 0.8 * filled(200, seed=5)

    def wave(x: torch.Tensor) -> torch.Tensor:
        return x + 0.1 * torch.sin(3 * x)

    def error(count: int) -> float:
        points = filled(count)
        away = PointMotion(points, wave(points))(places) - wave(places)
        return float(away.norm(dim=-1).mean())

    # The error is of second order: half the spacing (8 times the points), a quarter of it.
    assert error(8000) < 1e-3
    assert 3 < error(1000) / error(8000) < 5
    points = filled(1000)
    motion = PointMotion(points, wave(points))
    step = 1e-6
    columns = [
        (motion(places + step * unit) - motion(places - step * unit)) / (2 * step)
        for unit in torch.eye(3, dtype=torch.float64)
    ]
    numeric = torch.stack(columns, dim=-1)
    torch.testing.assert_close(motion.jacobian(places), numeric, rtol=1e-5, atol=1e-5)


def test_a_linear_map_is_kept_everywhere():
    points, places = filled(), filled(50, seed=2)
    linear = MOTION.jacobian(points)
    torch.testing.assert_close(PointMotion(points, MOTION(points), linear)(places), MOTION(places))


@pytest.mark.parametrize("count", [1, 2, 5])
def test_few_points_go_as_one_piece(count: int):
    points = filled(count)
    shift = torch.tensor([1.0, 2.0, 3.0]).double()
    motion = PointMotion(points, points + shift)
    places = filled(7, seed=3)
    torch.testing.assert_close(motion(places), places + shift, rtol=0, atol=1e-6)


def test_equally_far_from_all_points_is_no_trouble():
    corners = torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 3).double()
    motion = PointMotion(corners, 2 * corners)
    torch.testing.assert_close(motion(torch.zeros(1, 3).double()), torch.zeros(1, 3).double())
    assert bool(torch.isfinite(motion.jacobian(torch.zeros(1, 3).double())).all())


def test_slopes_of_a_value():
    points = filled(2000)
    slopes = scalar_slopes(points, 3 * points[:, 0])
    inner = (points[:, 0] > points[:, 0].min()) & (points[:, 0] < points[:, 0].max())
    expected = torch.tensor([3.0, 0, 0]).double().expand(int(inner.sum()), 3)
    torch.testing.assert_close(slopes[inner], expected, rtol=0, atol=0.05)
    assert slopes[~inner].abs().max() == 0


def test_misfits_are_refused():
    with pytest.raises(InputError, match="expected one of each for 5 sites"):
        Scattered(sites=filled(5), values=torch.zeros(4, 3), slopes=torch.zeros(5, 3, 3))
