"""How much is measured, and on what."""

from __future__ import annotations

from dataclasses import dataclass

import torch


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How much is measured."""

    device: torch.device
    quick: bool = False
    """Sizes that only show that it runs."""
    whole: bool = False
    """The whole matrix of sizes, which takes an hour; without it the sizes that have bars, and a
    few more."""
    turns: int = 5
    """Turns that count, of short calls; `long_turns` of long ones."""

    @property
    def bars(self) -> bool:
        """Whether the bars hold: ratios were promised for a CPU, and for sizes that count."""
        return self.device.type == "cpu" and not self.quick

    @property
    def long_turns(self) -> int:
        """Turns of calls that take seconds; three, so that the median is one in the middle."""
        return min(3, self.turns)
