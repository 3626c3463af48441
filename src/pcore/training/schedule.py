"""Learning rates over time, as pure functions of the step."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Linear warm-up, then a cosine from the base rate down to `final` times it."""

    base: float
    """Learning rate after the warm-up."""
    warmup: int = 0
    """Steps of linear warm-up."""
    final: float = 0.0
    """Fraction of the base rate that is left at the last step."""

    def at(self, step: int, steps: int) -> float:
        """Rate of step 0 <= step < steps."""
        if step < self.warmup:
            return self.base * (step + 1) / self.warmup
        progress = (step - self.warmup) / max(1, steps - self.warmup)
        return self.base * (self.final + (1 - self.final) * 0.5 * (1 + math.cos(math.pi * progress)))
