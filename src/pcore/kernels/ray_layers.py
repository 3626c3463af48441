"""Layers of a deformed ray: which of its points met it together in the rest state."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class LayerRules:
    """How strangers are told; world units of the rest state.

    The foremost point of a ray is the first along it among those that are close to it. Of the
    points behind that, strangers are those from which the ray of the rest state passes it apart.

    Attributes:
        close: largest distance of the foremost from the ray it sees.
        apart: distance of the foremost from the ray that a point sees, beyond which they never
            met it together.
        cutoff: points farther than this from the ray they see get no attention, and are left where
            they are, among the front.
    """

    close: float
    apart: float
    cutoff: float


@dataclass(frozen=True, kw_only=True)
class PulledBack:
    """R rays as points see them in the rest state.

    Attributes:
        neighbours: (R, k) indices of points, nearest first; slots without a point repeat the first.
        origins: (R, k, 3) of the rays of the rest state, world units.
        directions: (R, k, 3) of unit length.
        counts: (R,) slots that hold a point.
        strangers: (R,) bool, whether there are strangers among the candidates.
    """

    neighbours: Tensor
    origins: Tensor
    directions: Tensor
    counts: Tensor
    strangers: Tensor
