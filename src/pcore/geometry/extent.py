"""How large a set of points is."""

from __future__ import annotations

from torch import Tensor


def size_of(points: Tensor) -> float:
    """Diagonal of the bounding box of points (N, 3), in their unit."""
    return float((points.amax(dim=0) - points.amin(dim=0)).norm())
