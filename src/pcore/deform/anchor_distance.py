"""How far points are from anchors: through space, or over the cloud itself."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import torch
from scipy.spatial import KDTree
from torch import Tensor

from pcore.deform.skinning import SkinningWeights, Weigher, gaussian_logits, softmax_weights
from pcore.geometry.neighbours import as_points, nearest_in, neighbour_graph, path_lengths

_QUERIES_AT_ONCE = 4096
_ENTRY_POINTS = 4
_NEIGHBOURS = 8
"""Anchors per point (paper: K_nn)."""


@dataclass(frozen=True, kw_only=True)
class Candidates:
    """The anchors that may carry each point.

    Attributes:
        anchors: (N, K) int64, nearest first.
        distances: (N, K) world units.
    """

    anchors: Tensor
    distances: Tensor


class AnchorDistance(Protocol):
    """Distance of any points to the anchors."""

    @property
    def anchors(self) -> Tensor:
        """(M, 3) the anchors, world units."""
        ...

    def candidates(self, points: Tensor, k: int) -> Candidates:
        """Return the k anchors nearest to points (N, 3); all M when there are fewer."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class StraightDistance:
    """Euclidean distance.

    Attributes:
        anchors: (M, 3) world units.
    """

    anchors: Tensor

    def candidates(self, points: Tensor, k: int) -> Candidates:
        """See `AnchorDistance.candidates`."""
        index, distance = nearest_in(self._tree, points, k)
        return Candidates(anchors=index, distances=distance)

    @cached_property
    def _tree(self) -> Any:
        return KDTree(as_points(self.anchors))


@dataclass(frozen=True, kw_only=True, eq=False)
class PathDistance:
    """Length of the shortest path over the graph of neighbours of a cloud.

    A hand that rests on a leg is near to it through space and far from it along the body. A point
    that is not of the cloud enters the graph at whichever of its 4 nearest points makes the
    path shortest.

    Attributes:
        points: (N, 3) the cloud, world units.
        indices: (M,) which of its points are the anchors.
        lengths: (N, M) shortest paths from every point to every anchor, world units.
    """

    points: Tensor
    indices: Tensor
    lengths: Tensor = field(repr=False)

    @property
    def anchors(self) -> Tensor:
        """(M, 3) world units."""
        return self.points[self.indices]

    @property
    def between(self) -> Tensor:
        """(M, M) distances of the anchors from each other."""
        return self.lengths[self.indices]

    def candidates(self, points: Tensor, k: int) -> Candidates:
        """See `AnchorDistance.candidates`."""
        parts = [
            torch.topk(self.distances(part), min(k, len(self.indices)), largest=False)
            for part in points.detach().split(_QUERIES_AT_ONCE)
        ]
        return Candidates(
            anchors=torch.cat([part.indices for part in parts]),
            distances=torch.cat([part.values for part in parts]).to(points.dtype),
        )

    def distances(self, points: Tensor) -> Tensor:
        """Distances (Q, M) of points (Q, 3) to all anchors, world units."""
        index, step = nearest_in(self._tree, points, _ENTRY_POINTS)
        return (self.lengths[index] + step.to(self.lengths).unsqueeze(-1)).amin(dim=1)

    @cached_property
    def _tree(self) -> Any:
        return KDTree(as_points(self.points))


def path_distance(points: Tensor, indices: Tensor, *, links: int = 8) -> PathDistance:
    """Measure all paths from a cloud's points (N, 3) to the anchors among them.

    Args:
        points: the canonical cloud, world units.
        indices: (M,) which points are anchors, from `farthest_points`.
        links: neighbours per point in the graph.
    """
    lengths = path_lengths(neighbour_graph(points, links), indices)
    return PathDistance(points=points.detach().clone(), indices=indices, lengths=lengths)


def anchor_spacing(between: Tensor) -> float:
    """Mean distance of M anchors from their nearest other anchor, from distances (M, M)."""
    others = between + torch.diag(torch.full((len(between),), torch.inf, dtype=between.dtype))
    return float(others.amin(dim=1).mean())


def distance_weigher(distance: AnchorDistance, *, sigma: float) -> Weigher:
    """Gaussian weights by distance: the baseline of the paper, and its variant over the graph.

    Args:
        distance: `StraightDistance` (baseline) or `PathDistance`.
        sigma: of exp(-d^2 / 2 sigma^2), world units; the baseline has 1.
    """

    def weigh(points: Tensor) -> SkinningWeights:
        found = distance.candidates(points, _NEIGHBOURS)
        return softmax_weights(found.anchors, gaussian_logits(found.distances, sigma))

    return weigh
