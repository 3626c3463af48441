"""Sums over the triangles of closed meshes: mean value coordinates and slopes (compiled).

Ju, Schaefer, Warren, "Mean Value Coordinates for Closed Triangular Meshes" (2005). For a place x
and a triangle with corner offsets u_k = p_k - x let N_k = u_{k+1} x u_{k-1}, theta_k the angle
between u_{k+1} and u_{k-1}, D = det(u_1, u_2, u_3) and m = 1/2 sum_k theta_k N_k / |N_k|, the
integral of the outward normal over the triangle's picture on the unit sphere. The corner k gets
N_k . m / D; summed over triangles and divided by the sum over vertices these are the coordinates.
The derivatives follow from d N_k = (u_{k-1} - u_{k+1}) x dx and d D = -(area normal) . dx; theta /
|N| is written as a function of N . N and u_{k+1} . u_{k-1}, so that nothing is divided by the sine
of a small angle.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Mesh = tuple[IntArray, IntArray, IntArray]  # faces; per corner the opposite edge and its sense

_FLAT = 1e-8  # share of |u_1||u_2||u_3| below which x lies in the plane of a triangle
_ON = 1e-6  # radians that the angles lack to a full half turn when x lies on a triangle
_AT = 1e-12  # share of the cage's size within which x is a vertex
_SMALL = 1e-4  # share (N . N) / (u . u)^2 below which a series is exact to double precision
REGULAR, _IN_PLANE, _ON_CAGE = 0, 1, 2


@numba.njit(cache=True, nogil=True)
def sum_faces(
    x: FloatArray,
    vertices: FloatArray,
    mesh: Mesh,
    edges: IntArray,
    size: float,
    weight: FloatArray,
    slope: FloatArray,
    scratch: FloatArray,
) -> int:
    """Sum all triangles up in `weight` (V,) and `slope` (V, 3) unless it is empty; not divided."""
    weight[:] = 0.0
    slope[:] = 0.0
    offset = vertices - x
    length = np.sqrt(offset[:, 0] ** 2 + offset[:, 1] ** 2 + offset[:, 2] ** 2)
    nearest = int(length.argmin())
    if length[nearest] <= _AT * size:
        weight[nearest] = 1.0
        return _ON_CAGE
    _fill_edges(offset, length, edges, slope.shape[0] > 0, scratch)
    kind, faces, opposite = REGULAR, mesh[0], mesh[1]
    for f in range(faces.shape[0]):
        determinant = _determinant(f, mesh, offset, scratch)
        reach = length[faces[f, 0]] * length[faces[f, 1]] * length[faces[f, 2]]
        if abs(determinant) > _FLAT * reach:
            _add_face(f, mesh, offset, determinant, weight, slope, scratch)
            continue
        kind = max(kind, _IN_PLANE)
        if _lies_on(f, opposite, offset, edges, scratch):
            # On the triangle itself all others count for nothing.
            weight[:] = 0.0
            for k in range(3):
                n = scratch[opposite[f, k]]
                weight[faces[f, k]] = math.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
            return _ON_CAGE
    return kind


@numba.njit(cache=True, nogil=True)
def _determinant(f: int, mesh: Mesh, offset: FloatArray, scratch: FloatArray) -> float:
    """D of a triangle, from the N of its first corner."""
    faces, opposite, sense = mesh
    c, e = faces[f, 0], opposite[f, 0]
    along = scratch[e, 0] * offset[c, 0] + scratch[e, 1] * offset[c, 1]
    return sense[f, 0] * (along + scratch[e, 2] * offset[c, 2])


@numba.njit(cache=True, nogil=True)
def _lies_on(
    f: int, opposite: IntArray, offset: FloatArray, edges: IntArray, scratch: FloatArray
) -> bool:
    """Whether a place in the plane of a triangle sees it all around."""
    angles, area = 0.0, 0.0
    for k in range(3):
        e = opposite[f, k]
        n = scratch[e]
        across = math.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
        a, b = edges[e, 0], edges[e, 1]
        along = (
            offset[a, 0] * offset[b, 0] + offset[a, 1] * offset[b, 1] + offset[a, 2] * offset[b, 2]
        )
        angles += math.atan2(across, along)
        area += across
    return area > 0 and math.pi - 0.5 * angles < _ON


@numba.njit(cache=True, nogil=True)
def _fill_edges(
    offset: FloatArray, length: FloatArray, edges: IntArray, with_slope: bool, scratch: FloatArray
) -> None:
    """Per edge: N (3), g = theta / |N|, and grad g (3) if wanted."""
    for e in range(edges.shape[0]):
        a, b = edges[e, 0], edges[e, 1]
        ax, ay, az = offset[a, 0], offset[a, 1], offset[a, 2]
        bx, by, bz = offset[b, 0], offset[b, 1], offset[b, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        s, c = nx * nx + ny * ny + nz * nz, ax * bx + ay * by + az * bz
        across, both = math.sqrt(s), (length[a] * length[b]) ** 2
        if c > 0 and s < _SMALL * c * c:
            q = s / (c * c)
            g = (1 - q * (1 / 3 - q * (1 / 5 - q * (1 / 7 - q / 9)))) / c
            h = (-2 / 3 + q * (4 / 5 - q * (6 / 7 - q * 8 / 9))) / (c * c * c)
        elif across > 0:
            g = math.atan2(across, c) / across
            h = (c / both - g) / s
        else:  # Between two vertices on their edge; its triangles notice that x lies on them.
            g, h = 0.0, 0.0
        scratch[e, 0], scratch[e, 1], scratch[e, 2], scratch[e, 3] = nx, ny, nz, g
        if with_slope:
            dx, dy, dz = bx - ax, by - ay, bz - az
            scratch[e, 4] = h * (ny * dz - nz * dy) + (ax + bx) / both
            scratch[e, 5] = h * (nz * dx - nx * dz) + (ay + by) / both
            scratch[e, 6] = h * (nx * dy - ny * dx) + (az + bz) / both


@numba.njit(cache=True, nogil=True)
def _add_face(
    f: int,
    mesh: Mesh,
    offset: FloatArray,
    determinant: float,
    weight: FloatArray,
    slope: FloatArray,
    scratch: FloatArray,
) -> None:
    """Add one triangle: N_k . m / D to the weights of its corners, and the derivatives."""
    faces, opposite, sense = mesh
    mx, my, mz = 0.0, 0.0, 0.0
    for k in range(3):
        e = opposite[f, k]
        half = 0.5 * scratch[e, 3] * sense[f, k]
        mx += half * scratch[e, 0]
        my += half * scratch[e, 1]
        mz += half * scratch[e, 2]
    for k in range(3):
        e = opposite[f, k]
        along = scratch[e, 0] * mx + scratch[e, 1] * my + scratch[e, 2] * mz
        weight[faces[f, k]] += sense[f, k] * along / determinant
    if slope.shape[0] > 0:
        _add_slopes(f, mesh, offset, determinant, (mx, my, mz), slope, scratch)


@numba.njit(cache=True, nogil=True)
def _add_slopes(
    f: int,
    mesh: Mesh,
    offset: FloatArray,
    determinant: float,
    m: tuple[float, float, float],
    slope: FloatArray,
    scratch: FloatArray,
) -> None:
    """Add grad (N_k . m / D) = (grad (N_k . m) + (N_k . m / D) (area normal)) / D at the corners.

    With the edge vectors E_k and g = theta / |N|, grad (N_k . m) is
    m x E_k + 1/2 sum_j ((N_j . N_k) grad g_j + g_j N_k x E_j).
    """
    faces, opposite, sense = mesh
    ax, ay, az, sx, sy, sz = _around(f, mesh, offset, scratch)
    for k in range(3):
        e, s = opposite[f, k], sense[f, k]
        nx, ny, nz = s * scratch[e, 0], s * scratch[e, 1], s * scratch[e, 2]
        p, q = faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
        ex, ey = offset[q, 0] - offset[p, 0], offset[q, 1] - offset[p, 1]
        ez = offset[q, 2] - offset[p, 2]
        gx = m[1] * ez - m[2] * ey + ny * sz - nz * sy
        gy = m[2] * ex - m[0] * ez + nz * sx - nx * sz
        gz = m[0] * ey - m[1] * ex + nx * sy - ny * sx
        for j in range(3):
            o = opposite[f, j]
            dot = nx * scratch[o, 0] + ny * scratch[o, 1] + nz * scratch[o, 2]
            dot *= 0.5 * sense[f, j]
            gx += dot * scratch[o, 4]
            gy += dot * scratch[o, 5]
            gz += dot * scratch[o, 6]
        value = (nx * m[0] + ny * m[1] + nz * m[2]) / determinant
        v = faces[f, k]
        slope[v, 0] += (gx + value * ax) / determinant
        slope[v, 1] += (gy + value * ay) / determinant
        slope[v, 2] += (gz + value * az) / determinant


@numba.njit(cache=True, nogil=True)
def _around(
    f: int, mesh: Mesh, offset: FloatArray, scratch: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """Area normal of a triangle, then 1/2 sum_j g_j E_j."""
    faces, opposite, sense = mesh
    ax, ay, az, sx, sy, sz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(3):
        e, t = opposite[f, j], sense[f, j]
        p, q = faces[f, (j + 1) % 3], faces[f, (j + 2) % 3]
        half = 0.5 * scratch[e, 3]
        ax += t * scratch[e, 0]
        ay += t * scratch[e, 1]
        az += t * scratch[e, 2]
        sx += half * (offset[q, 0] - offset[p, 0])
        sy += half * (offset[q, 1] - offset[p, 1])
        sz += half * (offset[q, 2] - offset[p, 2])
    return ax, ay, az, sx, sy, sz
