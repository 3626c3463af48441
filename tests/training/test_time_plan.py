"""Settings from a promise, for machines whose speed is made up."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pcore.training.gaussian_config import GaussianConfig
from pcore.training.presets import preset
from pcore.training.schedule import reduction_at
from pcore.training.speed import Speed, speed_from
from pcore.training.time_plan import Photos, ShortPromiseError, plan_gaussians, plan_papr

SPEED = Speed(fixed=4e-3, pixel=8e-7, gaussian=1.4e-6)
PHOTOS = Photos(width=800, height=800, count=100, coverage=0.2)


def seconds_of(config: GaussianConfig, photos: Photos, factor: int, speed: Speed) -> float:
    """What the steps take, one by one."""
    total = 0.0
    for step in range(config.steps):
        reduction = reduction_at(config.levels, step / config.steps)
        room = max(config.points, config.density.limit // reduction)
        total += speed.seconds(photos.pixels(factor * reduction), room)
    return total


@pytest.mark.parametrize("minutes", [3, 10, 20, 60])
@pytest.mark.parametrize("slower", [0.2, 1.0, 4.0])
def test_the_steps_take_the_promised_time(minutes: float, slower: float) -> None:
    parts = ("fixed", "pixel", "gaussian")
    speed = replace(SPEED, **{name: slower * getattr(SPEED, name) for name in parts})
    plan = plan_gaussians(PHOTOS, speed, 60 * minutes, GaussianConfig())
    took = seconds_of(plan.config, PHOTOS, plan.factor, speed)
    assert took == pytest.approx(60 * minutes, rel=0.05)
    assert plan.config.seconds == 60 * minutes


def test_more_time_is_finer_photos_then_more_gaussians_then_more_steps() -> None:
    plans = [plan_gaussians(PHOTOS, SPEED, 60 * n, GaussianConfig()) for n in (1, 4, 20, 200, 2000)]
    assert [plan.factor for plan in plans] == sorted((p.factor for p in plans), reverse=True)
    assert plans[0].factor > plans[2].factor == 1
    limits = [plan.config.density.limit for plan in plans]
    assert limits == sorted(limits)
    assert limits[1] < limits[3]
    assert plans[4].config.steps > 5 * plans[3].config.steps


def test_schedules_go_from_coarse_to_fine() -> None:
    levels = plan_gaussians(PHOTOS, SPEED, 1200, GaussianConfig()).config.levels
    assert levels is not None
    assert [level.reduction for level in levels] == [8, 4, 2]
    assert [reduction_at(levels, at) for at in (0.0, 0.3, 0.5, 0.9)] == [8, 4, 2, 1]
    small = Photos(width=100, height=100, count=100, coverage=0.2)
    assert plan_gaussians(small, SPEED, 90, GaussianConfig()).config.levels is None


def test_a_given_factor_is_kept() -> None:
    assert plan_gaussians(PHOTOS, SPEED, 600, GaussianConfig(), factor=1).factor == 1


def test_photos_are_divided_by_what_divides_both_sides() -> None:
    photos = Photos(width=1080, height=1920, count=50, coverage=1.0)
    assert photos.factors() == [1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 24, 30]
    assert Photos(width=101, height=103, count=5, coverage=1.0).factors() == [1]
    odd = Photos(width=201, height=403, count=5, coverage=1.0, any_factor=True)
    assert odd.factors() == [1, 2, 3, 4, 5, 6]


def test_too_little_time_is_refused_with_what_is_needed() -> None:
    for seconds in (1.0, 0.001, -20.0):
        with pytest.raises(ShortPromiseError, match=r"200 steps, which take \d+ seconds") as caught:
            plan_gaussians(PHOTOS, SPEED, seconds, GaussianConfig())
        needed = caught.value.needed
        assert plan_gaussians(PHOTOS, SPEED, 1.01 * needed, GaussianConfig()).config.steps == 202


def test_a_model_of_the_speed_is_found_again_in_what_it_says() -> None:
    sizes = [(1e4, 4e3), (4e4, 4e3), (1e4, 16e3), (4e4, 16e3)]
    found = speed_from([(p, n, SPEED.seconds(p, n)) for p, n in sizes])
    assert found.seconds(6.4e5, 1e5) == pytest.approx(SPEED.seconds(6.4e5, 1e5), rel=1e-6)
    # A machine on which nothing seems to cost anything.
    assert speed_from([(p, n, 0.02) for p, n in sizes]).seconds(1e6, 1e6) > 0


def test_papr_gets_finer_photos_when_there_are_steps_for_them() -> None:
    """A usual training of 100 pixels has 3,500 steps, which at 0.2 seconds are 12 minutes."""
    base, step = preset("tiny"), 0.2
    plans = [plan_papr(PHOTOS, step, 60 * n, base) for n in (3, 12, 60, 1000)]
    assert [plan.factor for plan in plans] == [8, 8, 4, 1]
    assert [plan.config.steps for plan in plans] == [900, 3600, 18_000, 300_000]
    assert plans[1].config.levels is None
    assert plans[2].config.levels is not None
    assert plans[2].config.points > plans[1].config.points == base.points
    assert plan_papr(PHOTOS, step, 180, base, factor=2).factor == 2
    with pytest.raises(ShortPromiseError, match=r"which take 40 seconds .*promise more minutes"):
        plan_papr(PHOTOS, step, 10, base)
