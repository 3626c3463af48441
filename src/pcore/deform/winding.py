"""Which places a closed triangle mesh holds (compiled)."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


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
