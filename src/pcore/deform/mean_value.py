"""Mean value coordinates of places in closed triangle meshes, and what they carry (compiled)."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from pcore.deform.mean_value_sums import REGULAR, FloatArray, IntArray, Mesh, sum_faces

_ASIDE = 1e-5  # share of the cage's size by which slopes are taken aside of a kink


def topology(faces: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Edges (E, 2), the edge opposite to every corner (F, 3), and its sense there (F, 3), +-1."""
    start, end = np.roll(faces, -1, axis=1), np.roll(faces, -2, axis=1)
    pairs = np.stack([np.minimum(start, end), np.maximum(start, end)], axis=-1).reshape(-1, 2)
    edges, index = np.unique(pairs, axis=0, return_inverse=True)
    sense = np.where(start < end, 1, -1).astype(np.int64)
    return edges, index.reshape(faces.shape).astype(np.int64), sense


@numba.njit(cache=True, nogil=True)
def weights_at(
    points: FloatArray,
    vertices: FloatArray,
    faces: IntArray,
    edges: IntArray,
    opposite: IntArray,
    sense: IntArray,
) -> NDArray[np.float32]:
    """Coordinates (V, N) float32 of points (N, 3) in a cage; each column sums to 1."""
    count, size = vertices.shape[0], _size(vertices)
    result = np.empty((count, points.shape[0]), dtype=np.float32)
    weight, slope = np.empty(count), np.empty((0, 3))
    scratch, mesh = np.empty((edges.shape[0], 8)), (faces, opposite, sense)
    for n in range(points.shape[0]):
        sum_faces(points[n], vertices, mesh, edges, size, weight, slope, scratch)
        result[:, n] = (weight / weight.sum()).astype(np.float32)
    return result


@numba.njit(cache=True, nogil=True)
def carried(
    points: FloatArray,
    vertices: FloatArray,
    faces: IntArray,
    edges: IntArray,
    opposite: IntArray,
    sense: IntArray,
    moves: FloatArray,
    with_slope: bool,
) -> tuple[FloatArray, FloatArray]:
    """Displacements (N, 3) of points (N, 3) and their derivatives (N, 3, 3), empty if not wanted.

    `moves` (V, 3) are the displacements of the cage's vertices.
    """
    total, count, size = points.shape[0], vertices.shape[0], _size(vertices)
    mesh, way = (faces, opposite, sense), np.zeros((total, 3))
    turn = np.zeros((total if with_slope else 0, 3, 3))
    weight, slope = np.empty(count), np.empty((count if with_slope else 0, 3))
    scratch = np.empty((edges.shape[0], 8))
    for n in range(total):
        kind = sum_faces(points[n], vertices, mesh, edges, size, weight, slope, scratch)
        way[n] = _mean(weight, moves)
        if with_slope:
            if kind != REGULAR:
                _sum_aside(points[n], vertices, mesh, edges, size, weight, slope, scratch)
            _add_turn(weight, slope, moves, turn[n])
    return way, turn


@numba.njit(cache=True, nogil=True)
def slopes_at(
    points: FloatArray,
    vertices: FloatArray,
    faces: IntArray,
    edges: IntArray,
    opposite: IntArray,
    sense: IntArray,
) -> NDArray[np.float32]:
    """Derivatives (V, N, 3) float32 of the coordinates of points (N, 3) by position."""
    total, count, size = points.shape[0], vertices.shape[0], _size(vertices)
    found = np.empty((count, total, 3), dtype=np.float32)
    weight, slope = np.empty(count), np.empty((count, 3))
    scratch, mesh = np.empty((edges.shape[0], 8)), (faces, opposite, sense)
    for n in range(total):
        kind = sum_faces(points[n], vertices, mesh, edges, size, weight, slope, scratch)
        if kind != REGULAR:
            _sum_aside(points[n], vertices, mesh, edges, size, weight, slope, scratch)
        whole = weight.sum()
        for j in range(3):
            common = slope[:, j].sum() / whole
            for v in range(count):
                found[v, n, j] = (slope[v, j] - common * weight[v]) / whole
    return found


@numba.njit(cache=True, nogil=True)
def _sum_aside(
    x: FloatArray,
    vertices: FloatArray,
    mesh: Mesh,
    edges: IntArray,
    size: float,
    weight: FloatArray,
    slope: FloatArray,
    scratch: FloatArray,
) -> None:
    """As `sum_faces` where the coordinates have a kink: across a triangle one side is taken."""
    aside = x + _ASIDE * size * np.array([0.48, 0.6, 0.64])
    sum_faces(aside, vertices, mesh, edges, size, weight, slope, scratch)


@numba.njit(cache=True, nogil=True)
def _add_turn(weight: FloatArray, slope: FloatArray, moves: FloatArray, turn: FloatArray) -> None:
    """Add to a matrix (3, 3) the derivative of the displacement at one place."""
    here, sum_weight = _mean(weight, moves), weight.sum()
    for v in range(weight.shape[0]):
        for i in range(3):
            share = (moves[v, i] - here[i]) / sum_weight
            for j in range(3):
                turn[i, j] += share * slope[v, j]


@numba.njit(cache=True, nogil=True)
def _mean(weight: FloatArray, moves: FloatArray) -> FloatArray:
    result = np.zeros(3)
    total = 0.0
    for v in range(moves.shape[0]):
        total += weight[v]
        for i in range(3):
            result[i] += weight[v] * moves[v, i]
    return result / total


@numba.njit(cache=True, nogil=True)
def _size(vertices: FloatArray) -> float:
    longest = 0.0
    for i in range(3):
        longest = max(longest, vertices[:, i].max() - vertices[:, i].min())
    return longest


@numba.njit(cache=True, nogil=True)
def winding_numbers(
    points: FloatArray, vertices: FloatArray, faces: NDArray[np.int64]
) -> FloatArray:
    """How often a closed mesh goes round points (N, 3): 0 outside, 1 or -1 inside.

    The sum of the solid angles of its triangles, divided by 4 pi. With a, b, c the offsets of the
    corners, tan(angle / 2) = det(a, b, c) / (|a||b||c| + (a . b) |c| + (b . c) |a| + (c . a) |b|)
    (van Oosterom and Strackee, "The Solid Angle of a Plane Triangle", 1983).
    """
    result = np.zeros(points.shape[0])
    for n in range(points.shape[0]):
        offset = vertices - points[n]
        length = np.sqrt(offset[:, 0] ** 2 + offset[:, 1] ** 2 + offset[:, 2] ** 2)
        total = 0.0
        for f in range(faces.shape[0]):
            i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
            ax, ay, az = offset[i, 0], offset[i, 1], offset[i, 2]
            bx, by, bz = offset[j, 0], offset[j, 1], offset[j, 2]
            cx, cy, cz = offset[k, 0], offset[k, 1], offset[k, 2]
            volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
            spread = length[i] * length[j] * length[k]
            spread += (ax * bx + ay * by + az * bz) * length[k]
            spread += (bx * cx + by * cy + bz * cz) * length[i]
            spread += (cx * ax + cy * ay + cz * az) * length[j]
            total += math.atan2(volume, spread)
        result[n] = total / (2.0 * math.pi)
    return result
