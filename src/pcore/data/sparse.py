"""Sparse points that structure from motion found, and where photos show them."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True, kw_only=True, eq=False)
class Sightings:
    """Which views show which points, M times.

    Attributes:
        names: of views of the scene, in all its splits.
        points: (M,) int64 rows of the points.
        views: (M,) int64 places in `names`.
        places: (M, 2) float32 column and row of the feature in the pixels of the view's camera,
            undistorted and down-scaled as the view is; comparable with `Camera.project`.
    """

    names: tuple[str, ...]
    points: Tensor
    views: Tensor
    places: Tensor

    def of(self, name: str) -> tuple[Tensor, Tensor]:
        """Points (K,) and places (K, 2) that one view shows; none for views it does not know."""
        known = self.names.index(name) if name in self.names else -1
        chosen = self.views == known
        return self.points[chosen], self.places[chosen]


@dataclass(frozen=True, kw_only=True, eq=False)
class SparsePoints:
    """Points of a reconstruction, world units of the scene.

    Attributes:
        positions: (N, 3) float32.
        colors: (N, 3) float32 in [0, 1]; None where the format has none.
        errors: (N,) float32 mean reprojection error in pixels of the photos; None where the format
            has none.
        seen_by: (N,) int64 number of photos that each was found in, also of such that are not in
            the scene; None where the format does not say.
        sightings: which views see them; None where the format does not say.
    """

    positions: Tensor
    colors: Tensor | None = None
    errors: Tensor | None = None
    seen_by: Tensor | None = None
    sightings: Sightings | None = None

    def __len__(self) -> int:
        return len(self.positions)
