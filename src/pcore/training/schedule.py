"""Learning rates and resolutions over time, as pure functions of step and progress."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from pcore.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Linear warm-up, then a cosine from the base rate down towards `final` times it."""

    base: float
    """Learning rate after the warm-up."""
    warmup: int = 0
    """Steps of linear warm-up."""
    final: float = 0.0
    """Fraction of the base rate at which the cosine ends."""
    part: float = 1.0
    """Part of the cosine that the steps go through: at 0.5 training ends half-way down, where the
    original's attention ends (its cosine is twice as long as the training)."""

    def at(self, step: int, steps: float) -> float:
        """Rate of step 0 <= step < steps."""
        if step < self.warmup:
            return self.base * (step + 1) / self.warmup
        progress = (step - self.warmup) / max(1, steps - self.warmup)
        height = 0.5 * (1 + math.cos(math.pi * self.part * progress))
        return self.base * (self.final + (1 - self.final) * height)


@dataclass(frozen=True, kw_only=True)
class Level:
    """A part of a schedule from coarse to fine, which sees smaller photos."""

    until: float
    """Progress from 0 to 1 at which it ends."""
    reduction: int
    """Whole number by which both sides of the photos are divided."""


Levels = Sequence[Level] | None
"""One after another; from the end of the last one on photos are whole. None: always."""


def reduction_at(levels: Levels, progress: float) -> int:
    """By how much photos are divided at a progress from 0 to 1."""
    return next((one.reduction for one in levels or () if progress < one.until), 1)


def check_levels(levels: Levels) -> None:
    """Raise InputError for levels that do not end one after another."""
    ends = [level.until for level in levels or ()]
    if sorted(set(ends)) != ends or not all(0 < end <= 1 for end in ends):
        raise InputError(f"levels: expected ends one after another from 0 to 1, got {ends}")
    if not all(level.reduction >= 1 for level in levels or ()):
        raise InputError("levels: expected to divide photos by whole numbers of at least 1")
