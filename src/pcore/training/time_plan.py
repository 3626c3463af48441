"""From a promise of minutes to settings: resolution, Gaussians, steps and schedule."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from pcore.errors import InputError
from pcore.training.config import PretrainConfig
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.schedule import Level
from pcore.training.speed import Speed

Config = TypeVar("Config", GaussianConfig, PretrainConfig)

_COARSEST = 80
"""Pixels along the longer side of the coarsest photos of a schedule."""
_SMALLEST = 64
"""No finest photos are smaller."""
_LEVEL_SHARES = {1: (1.0,), 2: (0.3, 0.7), 3: (0.25, 0.3, 0.45), 4: (0.2, 0.2, 0.25, 0.35)}
"""Shares of the steps by the number of resolutions, coarse to fine."""
_LEAST_STEPS = 1500
"""A schedule of fewer steps at a resolution is worse than a whole one at half of it."""
_FEWEST_STEPS = 200
"""What is trained in fewer steps is no object yet."""
_USUAL_STEPS = 4000
"""Steps before time goes into more Gaussians."""
_DENSE, _DENSEST = 1.2, 5.0
"""Gaussians per pixel that the object covers in a photo, with little time and with much."""
_FEWEST, _MOST = 6_000, 300_000
_PAPR_SIDE, _PAPR_STEPS = 100, 3500
"""Pixels along a side that so many steps of PAPR are a usual training for (`presets.TINY`)."""
_PAPR_MOST, _PAPR_COARSE = 15_000, 0.3
"""Points at most; share of the steps with photos of half the size, where they are fine."""
_START_SHARE = 0.25
"""Gaussians at the start, of those at the end."""


class ShortPromiseError(InputError):
    """Too little time for any training; `needed` are the seconds that its fewest steps take."""

    def __init__(self, seconds: float, step_seconds: float) -> None:
        self.needed = _FEWEST_STEPS * step_seconds
        super().__init__(
            f"training: expected time for at least {_FEWEST_STEPS} steps, which take "
            f"{self.needed:.0f} seconds on this machine, got {max(seconds, 0):.0f} seconds besides "
            "reading, saving and the light; promise more minutes"
        )


@dataclass(frozen=True, kw_only=True)
class Photos:
    """What a plan asks of the training photos.

    Attributes:
        width: pixels of the largest one.
        height: pixels of the largest one.
        count: how many there are.
        coverage: share of the pixels that the object covers; 1 without masks.
        any_factor: whether a factor need not divide both sides.
    """

    width: int
    height: int
    count: int
    coverage: float
    any_factor: bool = False

    def pixels(self, factor: int) -> float:
        """Of one photo at 1 / factor of its size."""
        return self.width * self.height / factor**2

    def factors(self) -> list[int]:
        """Whole numbers to divide by that leave photos large enough, finest first."""
        longest = max(self.width, self.height)
        if self.any_factor:
            return [*range(1, max(1, longest // _SMALLEST) + 1)]
        common = math.gcd(self.width, self.height)
        return [
            n for n in range(1, common + 1) if common % n == 0 and longest / n >= _SMALLEST
        ] or [1]


@dataclass(frozen=True, kw_only=True)
class TimePlan(Generic[Config]):
    """How a promise will be kept.

    Attributes:
        factor: by which the photos are divided for good.
        config: settings, with the promise in them.
    """

    factor: int
    config: Config


def plan_gaussians(
    photos: Photos,
    speed: Speed,
    seconds: float,
    base: GaussianConfig,
    *,
    factor: int | None = None,
) -> TimePlan[GaussianConfig]:
    """Choose settings whose training takes so many seconds on a machine of a speed.

    The finest photos for which there are enough steps; then as many Gaussians as leave the usual
    number of steps; what is left are more steps.

    Args:
        photos: of the scene, undivided.
        speed: of this machine with this scene.
        seconds: for all steps, validations and saves.
        base: what is not chosen here.
        factor: by which photos are divided; None chooses it.

    Raises:
        ShortPromiseError: less time than the smallest training takes.
    """
    factors = photos.factors() if factor is None else [factor]
    *finer, coarsest = factors
    for one in finer:
        plan, _ = _at(photos, speed, seconds, base, one)
        if plan.config.steps >= _LEAST_STEPS:
            return plan
    plan, step_seconds = _at(photos, speed, seconds, base, coarsest)
    if plan.config.steps < _FEWEST_STEPS:
        raise ShortPromiseError(seconds, step_seconds)
    return plan


def plan_papr(
    photos: Photos,
    step_seconds: float,
    seconds: float,
    base: PretrainConfig,
    *,
    factor: int | None = None,
) -> TimePlan[PretrainConfig]:
    """Choose settings of PAPR whose training takes so many seconds.

    A step costs the same for photos of any size, since it draws a patch; but finer photos have more
    to learn. So the finest ones are taken whose pixels get as many steps as those of the usual size
    do in a usual training.

    Args:
        photos: of the scene, undivided.
        step_seconds: of a step of `base`.
        seconds: for all steps, validations and saves.
        base: what is not chosen here.
        factor: by which photos are divided; None chooses it.

    Raises:
        ShortPromiseError: less time than the smallest training takes.
    """
    steps = max(1, int(seconds / step_seconds))
    if steps < _FEWEST_STEPS:
        raise ShortPromiseError(seconds, step_seconds)
    longest = max(photos.width, photos.height)
    side = _PAPR_SIDE * math.sqrt(max(1.0, steps / _PAPR_STEPS))
    factors = photos.factors() if factor is None else [factor]
    # A fifth more pixels than that is no reason for half of them.
    chosen = next((one for one in factors if longest / one <= 1.2 * side), factors[-1])
    fine = longest / chosen > 1.5 * _PAPR_SIDE
    points = min(_PAPR_MOST, int(base.points * max(1.0, longest / chosen / _PAPR_SIDE)))
    config = replace(
        base,
        steps=steps,
        points=points,
        levels=(Level(until=_PAPR_COARSE, reduction=2),) if fine else None,
        seconds=seconds,
    )
    return TimePlan(factor=chosen, config=config)


def _at(
    photos: Photos, speed: Speed, seconds: float, base: GaussianConfig, factor: int
) -> tuple[TimePlan[GaussianConfig], float]:
    """The plan for photos of one size, and the seconds of its steps in the mean."""
    reductions = _reductions(max(photos.width, photos.height) / factor)
    shares = _LEVEL_SHARES[len(reductions)]
    covered = photos.pixels(factor) * photos.coverage

    def mean_cost(limit: float) -> float:
        costs = [
            speed.seconds(photos.pixels(factor * one), max(limit / one, _START_SHARE * limit))
            for one in reductions
        ]
        return sum(cost * share for cost, share in zip(costs, shares, strict=True))

    # The cost is linear in the number: as many as leave the usual steps, within bounds.
    empty = mean_cost(0)
    each = (mean_cost(1000) - empty) / 1000
    affordable = (seconds / _USUAL_STEPS - empty) / each
    wanted = min(max(affordable, _DENSE * covered), _DENSEST * covered)
    limit = int(min(max(wanted, _FEWEST), _MOST))
    levels, end = list[Level](), 0.0
    for one, share in zip(reductions[:-1], shares[:-1], strict=True):
        end += share
        levels.append(Level(until=round(end, 6), reduction=one))
    config = replace(
        base,
        steps=max(1, int(seconds / mean_cost(limit))),
        points=max(1000, int(_START_SHARE * limit)),
        density=replace(base.density, limit=limit, last=0.5 if not levels else 0.75),
        levels=tuple(levels) or None,
        seconds=seconds,
    )
    return TimePlan(factor=factor, config=config), mean_cost(limit)


def _reductions(longest: float) -> list[int]:
    """Divisors of a schedule, coarse to fine, the last of which is 1."""
    halvings = min(len(_LEVEL_SHARES) - 1, max(0, int(math.log2(longest / _COARSEST))))
    return [2**n for n in range(halvings, -1, -1)]
