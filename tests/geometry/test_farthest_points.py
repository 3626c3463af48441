"""Farthest point sampling against its definition."""

import pytest
import torch

from pcore.errors import InputError
from pcore.geometry.farthest_points import farthest_points


def test_each_next_anchor_is_the_farthest_from_those_before() -> None:
    points = torch.randn(200, 3)
    chosen = farthest_points(points, 12, seed=3)
    for count in range(1, 12):
        distance = torch.cdist(points, points[chosen[:count]]).amin(dim=1)
        assert distance[chosen[count]] == pytest.approx(float(distance.max()), rel=1e-6)


def test_the_seed_alone_decides() -> None:
    points = torch.randn(300, 3)
    state = torch.get_rng_state()
    first = farthest_points(points, 20, seed=5)
    assert torch.equal(first, farthest_points(points, 20, seed=5))
    assert torch.equal(torch.get_rng_state(), state)
    starts = {int(farthest_points(points, 1, seed=seed)) for seed in range(8)}
    assert len(starts) > 1


def test_all_points_can_be_anchors() -> None:
    chosen = farthest_points(torch.randn(9, 3), 9)
    assert sorted(chosen.tolist()) == list(range(9))


def test_bad_input() -> None:
    with pytest.raises(InputError, match="expected at least 5 points to choose from, got 4"):
        farthest_points(torch.zeros(4, 3), 5)
    with pytest.raises(InputError, match="expected at least 3 different places, got 1"):
        farthest_points(torch.zeros(4, 3), 3)
    with pytest.raises(InputError, match=r"expected points \(N, 3\), at least one, got \(4, 2\)"):
        farthest_points(torch.zeros(4, 2), 1)
    with pytest.raises(InputError, match="got NaN or infinity"):
        farthest_points(torch.full((4, 3), torch.nan), 1)
    with pytest.raises(InputError, match="count: expected a whole number of at least 1, got 0"):
        farthest_points(torch.zeros(4, 3), 0)
