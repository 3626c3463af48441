"""How much of a change a budget allows: its ends, what it meets, what it refuses."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import pytest
import torch
from torch import Tensor

from pcore.errors import InputError, TrainingError
from pcore.training.budget import Budget, interpolated, largest_part

BEFORE = {
    "cloud.influence": torch.tensor([0.1, 0.7, 1e-20]),
    "papr.weight": torch.tensor([[0.3, -1.7], [1e8, 0.0]]),
}
AFTER = {
    "cloud.influence": torch.tensor([0.4, -0.9, 3.3]),
    "papr.weight": torch.tensor([[0.7, 2.3], [1.0, 0.1]]),
}


def share_of(weights: Mapping[str, Tensor]) -> float:
    """Where weights lie between the ends."""
    before, after = BEFORE["cloud.influence"][0], AFTER["cloud.influence"][0]
    return float((weights["cloud.influence"][0] - before) / (after - before))


def test_the_ends_are_exact_and_copied() -> None:
    for share, end in ((0.0, BEFORE), (1.0, AFTER)):
        found = interpolated(BEFORE, AFTER, share)
        assert found.keys() == end.keys()
        for name, tensor in found.items():
            assert torch.equal(tensor, end[name])
            assert tensor.data_ptr() not in {BEFORE[name].data_ptr(), AFTER[name].data_ptr()}


def test_between_the_ends_lies_the_straight_line() -> None:
    found = interpolated(BEFORE, AFTER, 0.25)["papr.weight"]
    expected = 0.75 * BEFORE["papr.weight"] + 0.25 * AFTER["papr.weight"]
    torch.testing.assert_close(found, expected)


def test_a_skinning_is_taken_whole() -> None:
    before = {**BEFORE, "skinning.layer": torch.zeros(3)}
    after = {**AFTER, "skinning.layer": torch.ones(3)}
    assert torch.equal(interpolated(before, after, 0.0)["skinning.layer"], torch.ones(3))


@pytest.mark.parametrize(
    "other", [{**AFTER, "cloud.influence": torch.zeros(4)}, {"cloud.influence": torch.zeros(3)}]
)
def test_ends_of_other_shapes(other: dict[str, Tensor]) -> None:
    with pytest.raises(TrainingError, match="one shape before and after"):
        interpolated(BEFORE, other, 0.5)


PROFILES: dict[str, Callable[[float], float]] = {
    "line": lambda share: 30 - share,
    "rises first": lambda share: 30 + 2 * share - 3 * share**2,
    "steep": lambda share: 30 - 20 * share,
    "dip in the middle": lambda share: 30 - 4 * share * (1 - share) - 0.6 * share,
    "breaks down": lambda share: math.nan if share > 0.3 else 30.0,
    "cliff at once": lambda share: 30.0 if share == 0 else 10.0,
}


@pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES)
@pytest.mark.parametrize("largest_loss", [0.0, 0.1, 0.5])
def test_the_part_meets_the_budget(profile: Callable[[float], float], largest_loss: float) -> None:
    budget = Budget(before=BEFORE, psnr=[30.0], largest_loss=largest_loss)

    def score(weights: Mapping[str, Tensor]) -> list[float]:
        return [profile(share_of(weights))]

    part = largest_part(budget, AFTER, [profile(1.0)], score)
    assert budget.met_by(part.psnr)
    assert part.psnr == (score(part.weights) if part.share else [30.0])
    assert share_of(part.weights) == pytest.approx(part.share, abs=1e-6)
    again = largest_part(budget, AFTER, [profile(1.0)], score)
    assert again.share == part.share
    # A little more of it is too much.
    assert not budget.met_by([profile(part.share + 1 / 128)])


def test_the_share_is_the_largest() -> None:
    budget = Budget(before=BEFORE, psnr=[30.0], largest_loss=0.5)
    part = largest_part(
        budget, AFTER, [29.0], lambda weights: [PROFILES["line"](share_of(weights))]
    )
    assert 0.5 - 1 / 128 <= part.share <= 0.5


def test_no_view_may_lose_more_whatever_others_win() -> None:
    budget = Budget(before=BEFORE, psnr=[30.0, 20.0], largest_loss=0.5)
    assert budget.met_by([29.5, 19.5])
    assert not budget.met_by([35.0, 19.4])
    # The second loses 2 dB by all of it, while the mean rises.
    part = largest_part(
        budget, AFTER, [34.0, 18.0], lambda weights: [34.0, 20.0 - 2 * share_of(weights)]
    )
    assert 0.25 - 1 / 128 <= part.share <= 0.25


def test_what_meets_the_budget_is_taken_as_it_is() -> None:
    def never(weights: Mapping[str, Tensor]) -> list[float]:
        raise AssertionError("nothing is left to measure")

    budget = Budget(before=BEFORE, psnr=[30.0], largest_loss=0.5)
    part = largest_part(budget, AFTER, [29.5], never)
    assert (part.share, part.psnr) == (1.0, [29.5])
    assert all(part.weights[name] is tensor for name, tensor in AFTER.items())


def test_numbers_that_are_none_meet_no_budget() -> None:
    assert not Budget(before=BEFORE, psnr=[30.0], largest_loss=99.0).met_by([math.nan])


@pytest.mark.parametrize("largest_loss", [-0.1, math.nan])
def test_no_budget_is_below_zero(largest_loss: float) -> None:
    with pytest.raises(InputError, match="largest_loss of 0 dB or more"):
        Budget(before=BEFORE, psnr=[30.0], largest_loss=largest_loss)
