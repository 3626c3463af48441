"""Learning rates over time, as pure functions of the step."""

from __future__ import annotations

import math
from dataclasses import dataclass


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

    def at(self, step: int, steps: int) -> float:
        """Rate of step 0 <= step < steps."""
        if step < self.warmup:
            return self.base * (step + 1) / self.warmup
        progress = (step - self.warmup) / max(1, steps - self.warmup)
        height = 0.5 * (1 + math.cos(math.pi * self.part * progress))
        return self.base * (self.final + (1 - self.final) * height)
