"""Learning rates over time; torch's own schedulers are the oracle."""

from __future__ import annotations

import math

import pytest
import torch

from pcore.training.schedule import Schedule


def test_warm_up_is_linear_and_reaches_the_base() -> None:
    schedule = Schedule(base=2.0, warmup=4)
    assert [schedule.at(step, 100) for step in range(4)] == [0.5, 1.0, 1.5, 2.0]
    assert schedule.at(4, 100) == 2.0


def test_cosine_from_base_to_zero() -> None:
    schedule = Schedule(base=2e-3)
    assert schedule.at(0, 400) == 2e-3
    assert schedule.at(100, 400) == pytest.approx(2e-3 * (1 + math.sqrt(0.5)) / 2)
    assert schedule.at(200, 400) == pytest.approx(1e-3)
    assert 0 < schedule.at(399, 400) < 1e-7
    rates = [schedule.at(step, 400) for step in range(400)]
    assert rates == sorted(rates, reverse=True)


def test_cosine_towards_a_final_fraction() -> None:
    schedule = Schedule(base=1.0, warmup=10, final=0.2)
    assert schedule.at(60, 110) == pytest.approx(0.6)
    assert schedule.at(109, 110) == pytest.approx(0.2, abs=1e-3)
    assert min(schedule.at(step, 110) for step in range(10, 110)) > 0.2


def test_a_run_shorter_than_its_warm_up() -> None:
    schedule = Schedule(base=1.0, warmup=10)
    assert [schedule.at(step, 5) for step in range(5)] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5])
    assert schedule.at(9, 10) == 1.0


def test_half_a_cosine_is_the_schedule_of_the_original() -> None:
    """After the warm-up, torch's cosine with T_max of twice the steps that are left."""
    steps, warmup = 120, 20
    optimizer = torch.optim.SGD([torch.nn.Parameter(torch.zeros(1))], lr=3e-4)
    oracle = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, T_max=2 * (steps - warmup))
    schedule = Schedule(base=3e-4, warmup=warmup, part=0.5)
    for step in range(warmup, steps):
        assert schedule.at(step, steps) == pytest.approx(oracle.get_last_lr()[0], rel=1e-6), step
        optimizer.step()
        oracle.step()
    assert schedule.at(steps, steps) == pytest.approx(1.5e-4)


def test_ending_at_half_the_rate_is_not_half_a_cosine() -> None:
    """A whole cosine down to one half has the same ends and is lower by up to an eighth."""
    original, other = Schedule(base=1.0, part=0.5), Schedule(base=1.0, final=0.5)
    gaps = [original.at(step, 1000) - other.at(step, 1000) for step in range(1001)]
    assert gaps[0] == gaps[-1] == pytest.approx(0)
    assert max(gaps) == pytest.approx(0.125, abs=1e-5)
