"""Anchors as a person moves them: their graph, and what the moved ones say about rotations."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import minimum_spanning_tree
from torch import Tensor

from pcore.deform.anchor_distance import (
    PathDistance,
    anchor_spacing,
    distance_weigher,
    path_distance,
)
from pcore.deform.skinning import AnchorPose, SkinnedDeformation, SkinningWeights, Weigher
from pcore.editing.contents import content_of, from_content
from pcore.errors import EditError, InputError
from pcore.geometry.farthest_points import ANCHORS, farthest_points
from pcore.geometry.neighbours import nearest
from pcore.geometry.point_cloud import size_of
from pcore.geometry.rotation import procrustes

SIGMA = 0.33
"""Width of the Gaussian weights along the cloud, in mean anchor spacings (docs/adr)."""
_LINKS = 6
_LEAST_WEIGHT = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class AnchorGraph:
    """Which anchors hold together, by paths over the cloud.

    Attributes:
        rest: (M, 3) anchors at rest, world units.
        between: (M, M) path lengths between them.
        links: (E, 2) pairs of linked anchors, each once.
        weights: (E,) how strongly, in (0, 1].
    """

    rest: Tensor
    between: Tensor
    links: Tensor
    weights: Tensor

    @cached_property
    def rows(self) -> tuple[Tensor, Tensor]:
        """Neighbours (M, D) of every anchor and their weights; short rows end in itself at 0."""
        count = len(self.rest)
        first = torch.cat([self.links[:, 0], self.links[:, 1]])
        second = torch.cat([self.links[:, 1], self.links[:, 0]])
        order = torch.argsort(first, stable=True)
        first, second, weights = first[order], second[order], self.weights.repeat(2)[order]
        degree = torch.bincount(first, minlength=count)
        column = torch.arange(len(first)) - (degree.cumsum(0) - degree)[first]
        index = torch.arange(count).unsqueeze(1).repeat(1, int(degree.max()))
        index[first, column] = second
        values = torch.zeros(index.shape, dtype=weights.dtype)
        values[first, column] = weights
        return index, values

    @property
    def spacing(self) -> float:
        """Mean distance of an anchor from the nearest other one along the cloud."""
        return anchor_spacing(self.between)


def anchor_graph(rest: Tensor, between: Tensor) -> AnchorGraph:
    """Link every anchor to its nearest ones along the cloud, in one piece.

    Links weigh exp(-(d / 2s)^2) with path length d and mean spacing s. A minimum spanning tree
    is always among them, so that no group of anchors comes loose.

    Args:
        rest: (M, 3) world units.
        between: (M, M) path lengths, finite.

    Raises:
        InputError: fewer than two anchors, or lengths of another shape.
    """
    count = len(rest)
    if count < 2 or tuple(between.shape) != (count, count):
        raise InputError(
            "anchor graph: expected at least 2 anchors and their distances (M, M), got "
            f"{tuple(rest.shape)} and {tuple(between.shape)}"
        )
    lengths = between.double().numpy()
    near = np.argsort(lengths, axis=1, kind="stable")[:, 1 : 1 + _LINKS]
    linked = np.zeros((count, count), dtype=bool)
    np.put_along_axis(linked, near, values=True, axis=1)
    tree = minimum_spanning_tree(csr_array(lengths)).toarray() > 0
    linked |= tree
    pairs = np.argwhere(np.triu(linked | linked.T, k=1))
    spacing = anchor_spacing(between)
    ratio = lengths[pairs[:, 0], pairs[:, 1]] / (2 * spacing)
    # A floor, so that a bridge between far pieces still holds.
    strength = np.maximum(np.exp(-np.square(ratio)), _LEAST_WEIGHT)
    return AnchorGraph(
        rest=rest.detach(),
        between=between,
        links=torch.from_numpy(pairs),
        weights=torch.from_numpy(strength),
    )


def neighbourhood_rotations(graph: AnchorGraph, moved: Tensor) -> Tensor:
    """Rotations (M, 3, 3) of anchors of which only the new places (M, 3) are known.

    Each is the weighted Procrustes fit to the anchor's links: R_i minimises
    sum_j w_ij |R (a_j - a_i) - (a'_j - a'_i)|^2.
    """
    index, weights = graph.rows
    before = graph.rest[index] - graph.rest.unsqueeze(1)
    after = moved[index] - moved.unsqueeze(1)
    return procrustes(before, after, weights.to(before))


def pose_from_places(graph: AnchorGraph, moved: Tensor) -> AnchorPose:
    """Pose of anchors from their new places (M, 3) alone (paper: "repositioning the anchors").

    Raises:
        EditError: places of another number of anchors, NaN or infinity.
    """
    if moved.shape != graph.rest.shape or not bool(torch.isfinite(moved).all()):
        raise EditError(
            f"anchors: expected finite places {tuple(graph.rest.shape)}, got {tuple(moved.shape)}"
            + ("" if bool(torch.isfinite(moved).all()) else " with NaN or infinity")
        )
    return AnchorPose(rest=graph.rest, moved=moved, rotations=neighbourhood_rotations(graph, moved))


@dataclass(frozen=True, kw_only=True, eq=False)
class AnchorRig:
    """A cloud with its anchors, ready to be posed: what is costly and done once.

    Attributes:
        points: (N, 3) the cloud, world units.
        indices: (M,) which of its points are the anchors.
        graph: which anchors hold together.
        weigher: weights of any points.
        weights: of the cloud's own points.
    """

    points: Tensor = field(repr=False)
    indices: Tensor = field(repr=False)
    graph: AnchorGraph
    weigher: Weigher = field(repr=False)
    weights: SkinningWeights = field(repr=False)
    _there: list[AnchorRig] = field(init=False, repr=False, default_factory=list["AnchorRig"])

    @property
    def size(self) -> float:
        """Diagonal of the bounding box of the cloud, world units."""
        return size_of(self.points)

    def is_of(self, *, count: int, seed: int) -> bool:
        """Whether its anchors are those that this count and seed choose from its cloud."""
        if len(self.indices) != count:
            return False
        return torch.equal(self.indices, _chosen(content_of(self.points.double()), count, seed))

    def at(self, points: Tensor) -> AnchorRig:
        """Return the rig after its cloud has moved to points (N, 3): each keeps its weights.

        Paths stay those of the rest state, so that parts which have come to touch stay apart. What
        is not of the cloud follows the nearest point of it.
        """
        places = points.detach().cpu().to(self.points.dtype)
        if torch.equal(places, self.points):
            return self
        # While something is dragged the cloud arrives where it arrived before.
        if self._there and torch.equal(self._there[0].points, places):
            return self._there[0]
        weights = self.weights

        def beside(queries: Tensor) -> SkinningWeights:
            rows = nearest(places, queries, 1)[0][:, 0]
            return SkinningWeights(anchors=weights.anchors[rows], values=weights.values[rows])

        graph = anchor_graph(places[self.indices], self.graph.between)
        self._there[:] = [replace(self, points=places, graph=graph, weigher=beside)]
        return self._there[0]

    def deformation(self, pose: AnchorPose) -> SkinnedDeformation:
        """Return the map of space that a pose means."""
        return SkinnedDeformation(
            pose=pose, weigher=self.weigher, bound=self.points, weights=self.weights
        )


def rig_of(
    points: Tensor, *, count: int = ANCHORS, seed: int = 0, also: tuple[int, ...] = ()
) -> AnchorRig:
    """Choose anchors of a cloud (N, 3) and weigh its points along the cloud.

    The last few rigs are kept, so that a drag of the same cloud does not pay again.

    Args:
        points: the canonical cloud, world units.
        count: number of anchors.
        seed: of the choice of the first one.
        also: indices of points that take the places of the anchors of the seed nearest to them.

    Raises:
        EditError: fewer points than anchors, fewer than two anchors, or NaN or infinity.
    """
    if count < 2:
        raise EditError(f"anchors: expected a count of at least 2, got {count}")
    try:
        return _rig(content_of(points.double()), count, seed, also)
    except InputError as error:
        raise EditError(str(error)) from error


def rig_with(distance: PathDistance, weigher: Weigher) -> AnchorRig:
    """Return the rig of a cloud whose weights come from elsewhere, such as a trained network."""
    return AnchorRig(
        points=distance.points,
        indices=distance.indices,
        graph=anchor_graph(distance.anchors, distance.between),
        weigher=weigher,
        weights=weigher(distance.points),
    )


@lru_cache(maxsize=4)
def _chosen(content: bytes, count: int, seed: int) -> Tensor:
    return farthest_points(from_content(content).float(), count, seed=seed)


def _replaced(points: Tensor, chosen: Tensor, also: tuple[int, ...]) -> Tensor:
    """Put points in the places of the anchors nearest to them, each in one of its own."""
    anchors, free = chosen.clone(), torch.ones(len(chosen), dtype=torch.bool)
    for row in also:
        distance = (points[chosen] - points[row]).norm(dim=1).masked_fill(~free, torch.inf)
        place = int(distance.argmin())
        anchors[place], free[place] = row, False
    return anchors


@lru_cache(maxsize=4)
def _rig(content: bytes, count: int, seed: int, also: tuple[int, ...]) -> AnchorRig:
    points = from_content(content).float()
    distance = path_distance(points, _replaced(points, _chosen(content, count, seed), also))
    sigma = SIGMA * anchor_spacing(distance.between)
    return rig_with(distance, distance_weigher(distance, sigma=sigma))
