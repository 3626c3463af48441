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
    repeats: int = 5
