"""Exact closest points on a triangle mesh, fast enough for tens of thousands of queries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_FIRST_CANDIDATES = 8
_CANDIDATES_AT_ONCE = 1_000_000  # about 0.3 GB while triangles are compared
_POINTS_AT_ONCE = 16_384


@dataclass(frozen=True, kw_only=True)
class SurfacePoints:
    """Closest points on a mesh.

    Attributes:
        face: (N,) index of the triangle.
        barycentric: (N, 3) weights of its corners, not negative, sum 1.
        distance: (N,) from the query to the closest point.
    """

    face: IntArray
    barycentric: FloatArray
    distance: FloatArray


@dataclass(frozen=True, kw_only=True)
class _SizeClass:
    """Triangles of similar size: those whose circle about the centroid is at most `radius`."""

    faces: IntArray
    radius: float
    tree: Any


class SurfaceSearch:
    """Closest-point queries against one mesh.

    A triangle can only beat the best distance d found so far when its centroid lies within
    d + r of the query, r being the triangle's radius about its centroid. Nearest centroids are
    fetched in growing numbers until no further one can; triangles are grouped by size (powers
    of two) so that one huge triangle does not widen the search among small ones.
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        """Prepare the search.

        Args:
            vertices: (V, 3).
            faces: (F, 3) indices of vertices, F at least 1.
        """
        self._corners: FloatArray = vertices[faces]
        centroids = self._corners.mean(axis=1)
        reach = np.linalg.norm(self._corners - centroids[:, None], axis=2).max(axis=1)
        self._reach: FloatArray = reach
        level = np.ceil(np.log2(np.maximum(reach, reach.max() * 2.0**-16) / reach.max()))
        groups = [np.flatnonzero(level == value) for value in np.unique(level)]
        # The largest group first: it brings the best distance down for all the others.
        self._classes = [
            _SizeClass(faces=g, radius=float(reach[g].max()), tree=KDTree(centroids[g]))
            for g in sorted(groups, key=len, reverse=True)
        ]

    def closest(self, points: FloatArray) -> SurfacePoints:
        """Closest point of the mesh to every query (N, 3); exact up to rounding."""
        parts = [
            self._closest(points[i : i + _POINTS_AT_ONCE])
            for i in range(0, len(points), _POINTS_AT_ONCE)
        ] or [_Best(0).frozen()]
        return SurfacePoints(
            face=np.concatenate([p.face for p in parts]),
            barycentric=np.concatenate([p.barycentric for p in parts]),
            distance=np.concatenate([p.distance for p in parts]),
        )

    def _closest(self, points: FloatArray) -> SurfacePoints:
        best = _Best(len(points))
        for group in self._classes:
            pending = np.arange(len(points))
            done, wanted = 0, _FIRST_CANDIDATES
            while len(pending):
                wanted = min(wanted, len(group.faces))
                step = max(1, _CANDIDATES_AT_ONCE // wanted)
                open_ = [
                    self._improve(best, group, points, pending[i : i + step], done, wanted)
                    for i in range(0, len(pending), step)
                ]
                if wanted == len(group.faces):
                    break
                pending = np.concatenate(open_)
                done, wanted = wanted, 4 * wanted
        return best.frozen()

    def _improve(
        self,
        best: _Best,
        group: _SizeClass,
        points: FloatArray,
        queries: IntArray,
        done: int,
        wanted: int,
    ) -> IntArray:
        """Try candidates number `done` to `wanted`; return the queries that need still more."""
        distance, index = group.tree.query(points[queries], k=wanted)
        distance = distance.reshape(len(queries), wanted)
        faces = group.faces[index.reshape(len(queries), wanted)]
        # A first look at one candidate each gives a bound that spares most of the others.
        if done == 0:
            self._compare(best, points, queries, faces[:, 0])
        hopeful = distance - self._reach[faces] < best.distance[queries, None]
        hopeful[:, : max(done, 1)] = False
        row, column = np.nonzero(hopeful)
        self._compare(best, points, queries[row], faces[row, column])
        return queries[distance[:, -1] - group.radius < best.distance[queries]]

    def _compare(self, best: _Best, points: FloatArray, queries: IntArray, faces: IntArray) -> None:
        corners = self._corners[faces]
        weights = closest_on_triangles(points[queries], corners)
        nearest = np.einsum("nk,nkd->nd", weights, corners)
        best.offer(queries, faces, weights, np.linalg.norm(points[queries] - nearest, axis=1))


class _Best:
    """The closest points found so far."""

    def __init__(self, count: int) -> None:
        self.face: IntArray = np.zeros(count, dtype=np.int64)
        self.barycentric: FloatArray = np.zeros((count, 3))
        self.distance: FloatArray = np.full(count, np.inf)

    def offer(
        self, queries: IntArray, faces: IntArray, weights: FloatArray, distance: FloatArray
    ) -> None:
        """Keep what is nearer; a query may be offered several faces at once."""
        # Later writes win: with the nearest written last, each query ends with its nearest.
        order = np.argsort(-distance, kind="stable")
        order = order[distance[order] < self.distance[queries[order]]]
        chosen = queries[order]
        self.face[chosen] = faces[order]
        self.barycentric[chosen] = weights[order]
        self.distance[chosen] = distance[order]

    def frozen(self) -> SurfacePoints:
        return SurfacePoints(face=self.face, barycentric=self.barycentric, distance=self.distance)


def closest_on_triangles(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Barycentric weights (N, 3) of the closest point on one triangle per query.

    Args:
        points: (N, 3).
        corners: (N, 3, 3) corners (second axis) of every query's triangle. Triangles without
            area are treated as their edges.
    """
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    relative = points - corners[:, 0]
    aa, ab, bb = _dot(first, first), _dot(first, second), _dot(second, second)
    pa, pb = _dot(relative, first), _dot(relative, second)
    gram = aa * bb - ab * ab
    flat = gram <= 1e-14 * aa * bb
    safe = np.where(flat, 1.0, gram)
    v, w = (bb * pa - ab * pb) / safe, (aa * pb - ab * pa) / safe
    weights = np.stack([1 - v - w, v, w], axis=1)
    outside = np.flatnonzero(flat | (weights.min(axis=1) < 0))
    weights[outside] = _closest_on_edges(points[outside], corners[outside])
    return weights


def _closest_on_edges(points: FloatArray, corners: FloatArray) -> FloatArray:
    weights = np.zeros((3, len(points), 3))
    distance = np.zeros((3, len(points)))
    for edge, (a, b) in enumerate([(0, 1), (1, 2), (2, 0)]):
        along = corners[:, b] - corners[:, a]
        length = np.maximum(_dot(along, along), np.finfo(np.float64).tiny)
        t = np.clip(_dot(points - corners[:, a], along) / length, 0, 1)
        weights[edge, :, a], weights[edge, :, b] = 1 - t, t
        gap = points - corners[:, a] - t[:, None] * along
        distance[edge] = _dot(gap, gap)
    return weights[distance.argmin(axis=0), np.arange(len(points))]


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.einsum("nd,nd->n", a, b)
