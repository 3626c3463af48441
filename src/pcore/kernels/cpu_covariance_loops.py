"""Covariances of quaternions and scales, and their gradients, by numba, in float64."""

from __future__ import annotations

import math

import numba
import numpy as np
from numba import prange

from pcore.kernels.cpu_projection_loops import CHUNK


@numba.njit(cache=True, error_model="numpy")
def _rotation(quat: np.ndarray, turn: np.ndarray) -> float:
    """Fill in the rotation (3, 3) of a quaternion w x y z; return the quaternion's length."""
    length = math.sqrt(
        float(quat[0]) ** 2 + float(quat[1]) ** 2 + float(quat[2]) ** 2 + float(quat[3]) ** 2
    )
    w, x, y, z = quat[0] / length, quat[1] / length, quat[2] / length, quat[3] / length
    turn[0, 0], turn[0, 1], turn[0, 2] = (
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
    )
    turn[1, 0], turn[1, 1], turn[1, 2] = (
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
    )
    turn[2, 0], turn[2, 1], turn[2, 2] = (
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    )
    return length


@numba.njit(cache=True, parallel=True, error_model="numpy")
def covariances(quats: np.ndarray, scales: np.ndarray, found: np.ndarray) -> None:
    """Fill in the entries xx, xy, xz, yy, yz, zz (N, 6) from quats (N, 4) and scales (N, 3)."""
    for chunk in prange((len(quats) + CHUNK - 1) // CHUNK):
        root = np.empty((3, 3))
        for n in range(chunk * CHUNK, min(len(quats), (chunk + 1) * CHUNK)):
            _rotation(quats[n], root)
            for j in range(3):
                for i in range(3):
                    root[i, j] *= scales[n, j]
            entry = 0
            for i in range(3):
                for j in range(i, 3):
                    found[n, entry] = (
                        root[i, 0] * root[j, 0] + root[i, 1] * root[j, 1] + root[i, 2] * root[j, 2]
                    )
                    entry += 1


@numba.njit(cache=True, parallel=True, error_model="numpy")
def covariances_backward(
    quats: np.ndarray,
    scales: np.ndarray,
    gradient: np.ndarray,
    results: tuple[np.ndarray, np.ndarray],
) -> None:
    """Fill in the gradients by quats and scales from that (N, 6) by the entries."""
    to_quats, to_scales = results
    for chunk in prange((len(quats) + CHUNK - 1) // CHUNK):
        turn, t = np.empty((3, 3)), np.empty((3, 3))
        for n in range(chunk * CHUNK, min(len(quats), (chunk + 1) * CHUNK)):
            length = _rotation(quats[n], turn)
            # Twice the gradient by a symmetric matrix, whose entries beside the diagonal are two.
            xx, yy, zz = 2.0 * gradient[n, 0], 2.0 * gradient[n, 3], 2.0 * gradient[n, 5]
            xy, xz, yz = float(gradient[n, 1]), float(gradient[n, 2]), float(gradient[n, 4])
            for j in range(3):
                a, b, c = turn[0, j], turn[1, j], turn[2, j]
                scale = float(scales[n, j])
                u, v, w = (
                    xx * a + xy * b + xz * c,
                    xy * a + yy * b + yz * c,
                    xz * a + yz * b + zz * c,
                )
                to_scales[n, j] = scale * (a * u + b * v + c * w)
                square = scale * scale
                t[0, j], t[1, j], t[2, j] = square * u, square * v, square * w
            w, x = quats[n, 0] / length, quats[n, 1] / length
            y, z = quats[n, 2] / length, quats[n, 3] / length
            dw = 2 * (x * (t[2, 1] - t[1, 2]) + y * (t[0, 2] - t[2, 0]) + z * (t[1, 0] - t[0, 1]))
            dx = 2 * (
                y * (t[0, 1] + t[1, 0])
                + z * (t[0, 2] + t[2, 0])
                + w * (t[2, 1] - t[1, 2])
                - 2 * x * (t[1, 1] + t[2, 2])
            )
            dy = 2 * (
                x * (t[0, 1] + t[1, 0])
                + z * (t[1, 2] + t[2, 1])
                + w * (t[0, 2] - t[2, 0])
                - 2 * y * (t[0, 0] + t[2, 2])
            )
            dz = 2 * (
                x * (t[0, 2] + t[2, 0])
                + y * (t[1, 2] + t[2, 1])
                + w * (t[1, 0] - t[0, 1])
                - 2 * z * (t[0, 0] + t[1, 1])
            )
            along = dw * w + dx * x + dy * y + dz * z
            to_quats[n, 0], to_quats[n, 1] = (dw - along * w) / length, (dx - along * x) / length
            to_quats[n, 2], to_quats[n, 3] = (dy - along * y) / length, (dz - along * z) / length
