"""How far sparse points lie from where the photos show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from pcore.data.scene import View
from pcore.data.sparse import SparsePoints

_FAR = 2.0
"""Mean errors in pixels of the photos above which a view stands out."""


@dataclass(frozen=True, kw_only=True)
class Reprojection:
    """Distances of points from their features.

    Attributes:
        mean: pixels of the photos' files, over all sightings.
        of_views: mean of each view, NaN where it has none.
        sightings: how many there are.
    """

    mean: float
    of_views: tuple[float, ...]
    sightings: int

    def doubtful(self) -> tuple[int, ...]:
        """Numbers of the views with a large error."""
        limit = max(_FAR, 2 * self.mean)
        return tuple(i for i, error in enumerate(self.of_views) if error > limit)


def reprojection(sparse: SparsePoints, views: Sequence[View]) -> Reprojection | None:
    """Measure the error of every view; None where the format does not say what views see."""
    if sparse.sightings is None:
        return None
    errors: list[float] = []
    total, count = 0.0, 0
    for view in views:
        points, places = sparse.sightings.of(view.name)
        column, row, _ = view.camera.project(sparse.positions[points])
        off = (torch.stack([column, row], dim=-1) - places).norm(dim=-1) * view.image.factor
        errors.append(float(off.mean()) if len(off) else float("nan"))
        total, count = total + float(off.sum()), count + len(off)
    if count == 0:
        return None
    return Reprojection(mean=total / count, of_views=tuple(errors), sightings=count)
