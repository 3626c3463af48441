"""Space that goes along with scattered points."""

import pytest
import torch

from pcore.deform.base import Compose
from pcore.deform.checks import count_folds
from pcore.deform.jacobian import fitted_maps
from pcore.deform.scattered import PointMotion, Scattered, scalar_slopes
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
    linear = PointMotion(points, MOTION(points)).jacobian(points)
    torch.testing.assert_close(linear, MOTION.jacobian(points), rtol=0, atol=1e-6)


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

    def error(count: int, *, exact: bool) -> float:
        points = filled(count)
        slopes = torch.eye(3) + torch.diag_embed(0.3 * torch.cos(3 * points)) if exact else None
        away = PointMotion(points, wave(points), slopes)(places) - wave(places)
        return float(away.norm(dim=-1).mean())

    # The error is of second order: half the spacing (8 times the points), a quarter of it.
    assert 3 < error(1000, exact=True) / error(8000, exact=True) < 5
    assert error(8000, exact=True) < 5e-4
    assert error(8000, exact=False) < 1e-3
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


def test_maps_that_were_given_are_replaced_where_they_fold_and_only_there():
    points, slopes = filled(), torch.eye(3).repeat(600, 1, 1).double()
    slopes[[3, 40]] = torch.diag(torch.tensor([1.0, 1.0, -1.0])).double()
    slopes[77] = 0.0
    slopes[5] *= 2.0
    motion = PointMotion(points, MOTION(points), slopes)
    assert motion.mended(points).nonzero().squeeze(-1).tolist() == [3, 40, 77]
    assert count_folds(motion, points).folded == 0
    found = motion.jacobian(points)
    torch.testing.assert_close(found[[3, 40, 77]], MOTION.jacobian(points[:3]), rtol=0, atol=1e-6)
    torch.testing.assert_close(found[5], slopes[5])
    chain = Compose(MOTION, PointMotion(MOTION(points), points, slopes))
    assert chain.mended(points).nonzero().squeeze(-1).tolist() == [3, 40, 77]
    assert not bool(MOTION.mended(points).any())


@pytest.mark.parametrize("known", [False, True])
def test_a_share_of_a_motion(known: bool):
    points = filled()
    after = points + 0.1 * torch.sin(3 * points)
    slopes = torch.eye(3) + torch.diag_embed(0.3 * torch.cos(3 * points)) if known else None
    motion = PointMotion(points, after, slopes)
    assert motion.eased(1.0) is motion
    assert torch.equal(motion.eased(0.0)(points), points)
    half = motion.eased(0.5)
    torch.testing.assert_close(half(points), 0.5 * (points + after))
    expected = 0.5 * (torch.eye(3) + motion.jacobian(points))
    torch.testing.assert_close(half.jacobian(points), expected, rtol=0, atol=1e-9)
    assert not bool(half.mended(points).any())


def test_a_half_turn_half_way_has_maps_that_can_be_undone():
    """Half way through half a turn everything lies on the axis: the blend of maps is singular."""
    points = filled() - 0.5
    turn = rigid((0, 0, 1), torch.pi)
    halved = PointMotion(points, turn(points), turn.jacobian(points)).eased(0.5)
    assert bool(halved.mended(points).all())
    assert count_folds(halved, points).folded == 0


def test_points_that_all_went_to_one_place_are_folded():
    linear, mended = fitted_maps(filled(), torch.ones(600, 3))
    assert not bool(linear.any())
    assert not bool(mended.any())
    motion = PointMotion(filled(), torch.ones(600, 3).double())
    assert count_folds(motion, filled()).folded == 600


def test_a_mirrored_motion_is_folded_everywhere():
    points = filled()
    mirrored = PointMotion(points, points * torch.tensor([1.0, 1.0, -1.0]).double())
    assert count_folds(mirrored, points).folded == 600


def test_where_fitted_maps_fold_is_known_without_them(monkeypatch):
    points = filled()
    torn = points.clone()
    torn[points[:, 0] > 0.5] += 5.0
    for after in (torn, torn.flip(0), 0 * points + 1.0, points * torch.tensor([1.0, 1.0, -1.0])):
        motion = PointMotion(points, after)
        expected = motion.folded_given(points, motion.jacobian(points))
        monkeypatch.setattr("pcore.deform.sites.fitted_maps", None)
        assert torch.equal(PointMotion(points, after).folded(points), expected)
        monkeypatch.undo()


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


@pytest.mark.parametrize("make", [sheet, filled])
def test_quick_maps_are_nearly_those_fitted_with_care(make):
    points = make()
    after = points + 0.1 * torch.sin(3 * points.roll(1, dims=1))
    quick, careful, again = (PointMotion(points, after, quick=one) for one in (True, False, True))
    assert torch.equal(careful(points), quick(points))
    error = (quick.jacobian(points) - careful.jacobian(points)).norm(dim=(1, 2))
    # What is known with care already is not made quickly.
    assert torch.equal(again.jacobian(points), careful.jacobian(points))
    assert 0 < float(error.median()) < 0.05
    assert float(error.max()) < 0.25
    turned = MOTION(points)
    found = PointMotion(points, turned, quick=True).jacobian(points)
    torch.testing.assert_close(found, MOTION.jacobian(points), rtol=0, atol=1e-3)


def test_quick_maps_make_no_spikes_beside_a_tear_and_mirror_nothing():
    points = filled()
    after = points.clone()
    after[points[:, 0] > 0.5] += 5.0
    linear = PointMotion(points, after, quick=True).jacobian(points)
    assert float(torch.linalg.svdvals(linear).max()) < 5.0
    flat = points * torch.tensor([1.0, 1.0, -1.0]).double()
    assert float(torch.linalg.det(PointMotion(points, flat, quick=True).jacobian(points)).min()) > 0
    one = torch.ones(1, 3).double()
    assert torch.equal(
        PointMotion(one, 2 * one, quick=True).jacobian(one)[0], torch.eye(3).double()
    )


def test_two_values_at_one_place_do_not_depend_on_who_asks():
    points = filled(20)
    points[1] = points[0]
    motion = PointMotion(points, points + torch.arange(20.0).double()[:, None])
    assert torch.equal(motion(points)[:1], motion(points[:1]))
