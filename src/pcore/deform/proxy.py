"""Points that follow a mesh near them, from one shape of it to another."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pcore.deform.scattered import PointMotion
from pcore.errors import InputError
from pcore.geometry.neighbours import as_points
from pcore.geometry.surface_search import SurfaceSearch

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class BoundMesh:
    """A mesh at rest and the points that will follow it.

    Attributes:
        points: (N, 3) float64 world units.
        rest: (V, 3) vertices.
        faces: (F, 3) vertex numbers.
        vertices: (N, 3) numbers of the corners of the triangle nearest to each point.
        share: (N, 3) barycentric coordinates of the nearest place in it.
    """

    points: Tensor
    rest: FloatArray
    faces: NDArray[np.int64]
    vertices: NDArray[np.int64]
    share: FloatArray

    @classmethod
    def of(cls, points: Tensor, before: Tensor, faces: Tensor) -> BoundMesh:
        """Find the triangle nearest to each of the points (N, 3), world units."""
        places, rest, corners = as_points(points), as_points(before), faces.cpu().numpy()
        found = SurfaceSearch(rest, corners).closest(places)
        return cls(
            points=torch.from_numpy(places),
            rest=rest,
            faces=corners,
            vertices=corners[found.face],
            share=found.barycentric,
        )

    def to(self, after: Tensor, *, quick: bool = False) -> PointMotion:
        """Motion of the points when the vertices go to (V, 3), extended to space around them.

        Every vertex gets a linear map: the mean over its triangles, by area, of the map that
        carries the edges of a triangle and its unit normal times the root of its area ratio. A
        point goes with the vertices of the triangle nearest to it, by barycentric weights b:
        p' = sum b (v' + A (p - v)). Raises InputError where no triangle has an area.
        """
        posed = as_points(after)
        linear = _vertex_maps(self.rest, posed, self.faces)
        moved, slopes = _followed(
            self.points.numpy(), self.rest, posed, linear, self.vertices, self.share
        )
        return PointMotion(
            self.points, torch.from_numpy(moved), torch.from_numpy(slopes), quick=quick
        )


def middle_distance(points: Tensor, vertices: Tensor, faces: Tensor) -> float:
    """Median distance of points (N, 3) from a mesh, world units; a thousand of them tell."""
    some = as_points(points)[:: max(1, len(points) // 1000)]
    found = SurfaceSearch(as_points(vertices), faces.cpu().numpy()).closest(some)
    return float(np.median(found.distance))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _followed(
    points: FloatArray,
    rest: FloatArray,
    posed: FloatArray,
    linear: FloatArray,
    vertices: NDArray[np.int64],
    share: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Places (N, 3) and Jacobians (N, 3, 3), see `BoundMesh.to`."""
    moved, slopes = np.zeros((len(points), 3)), np.zeros((len(points), 3, 3))
    for n in range(len(points)):
        for k in range(3):
            v, weight = vertices[n, k], share[n, k]
            x, y, z = (
                points[n, 0] - rest[v, 0],
                points[n, 1] - rest[v, 1],
                points[n, 2] - rest[v, 2],
            )
            for i in range(3):
                a, b, c = linear[v, i, 0], linear[v, i, 1], linear[v, i, 2]
                # In the order in which NumPy's einsum adds, which was here first: the same bits.
                moved[n, i] += weight * (posed[v, i] + (a * x + c * z + b * y))
                for j in range(3):
                    slopes[n, i, j] += weight * linear[v, i, j]
    return moved, slopes


def _vertex_maps(rest: FloatArray, posed: FloatArray, faces: NDArray[np.int64]) -> FloatArray:
    old, area = face_frames(rest[faces])
    new, new_area = face_frames(posed[faces])
    sound = area > 1e-12 * area.max()
    if not sound.any():
        raise InputError(
            "mesh: expected triangles with an area, got none; is it a line or a point?"
        )
    ratio = np.sqrt(new_area[sound] / area[sound])
    new = new[sound]
    new[:, :, 2] *= ratio[:, None]
    maps = new @ np.linalg.inv(old[sound])
    total = np.zeros((len(rest), 3, 3))
    weight = np.zeros(len(rest))
    for k in range(3):
        np.add.at(total, faces[sound, k], area[sound, None, None] * maps)
        np.add.at(weight, faces[sound, k], area[sound])
    used = weight > 0
    total[used] /= weight[used, None, None]
    total[~used] = np.eye(3)
    return total


def face_frames(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Edges and unit normal of triangles (F, 3, 3) as columns (F, 3, 3), and areas (F,)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(first, second)
    length = np.linalg.norm(normal, axis=1)
    unit = normal / np.maximum(length, np.finfo(np.float64).tiny)[:, None]
    return np.stack([first, second, unit], axis=-1), 0.5 * length
