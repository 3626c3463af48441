"""Projection of Gaussians into pictures by numba, in float64 between arrays of either type."""

from __future__ import annotations

import math

import numba
import numpy as np
from numba import prange

BEYOND = 0.15
"""The linearised projection follows centres up to so many picture sizes beyond the border."""
SMALLEST_SHARE = 1e-12
"""Least squared part of its opacity that the screen filter leaves a Gaussian, for its root."""
CHUNK = 256
"""Gaussians that are worked on, and whose gradients by cameras are summed, together."""


@numba.njit(cache=True, error_model="numpy")
def seen(mean: np.ndarray, view: np.ndarray) -> tuple[float, float, float]:
    """Camera coordinates of a place."""
    x, y, z = float(mean[0]), float(mean[1]), float(mean[2])
    return (
        view[0, 0] * x + view[0, 1] * y + view[0, 2] * z + view[0, 3],
        view[1, 0] * x + view[1, 1] * y + view[1, 2] * z + view[1, 3],
        view[2, 0] * x + view[2, 1] * y + view[2, 2] * z + view[2, 3],
    )


@numba.njit(cache=True, error_model="numpy")
def kept_slopes(
    slopes: tuple[float, float], lens: np.ndarray, screen: tuple[float, float, float, float]
) -> tuple[float, float]:
    """Slopes x / z and y / z of a place, within what the linearised projection follows."""
    x, y = lens[0, 2], lens[1, 2]
    room_x, room_y = BEYOND * screen[0], BEYOND * screen[1]
    left, right = -(x + room_x) / lens[0, 0], (screen[0] - x + room_x) / lens[0, 0]
    top, bottom = -(y + room_y) / lens[1, 1], (screen[1] - y + room_y) / lens[1, 1]
    return min(max(slopes[0], left), right), min(max(slopes[1], top), bottom)


@numba.njit(cache=True, error_model="numpy")
def flattened(
    covariance: np.ndarray,
    view: np.ndarray,
    slopes: tuple[float, float],
    scale: tuple[float, float],
    j: np.ndarray,
    a: np.ndarray,
) -> tuple[float, float, float]:
    """The 2 x 2 covariance xx, xy, yy in the picture.

    Fills in j (2, 3), the derivatives of a pixel's coordinates by the place, and a (2, 3), the
    covariance times them.
    """
    s = covariance
    for axis in range(2):
        for i in range(3):
            j[axis, i] = scale[axis] * (view[axis, i] - slopes[axis] * view[2, i])
        x, y, z = j[axis, 0], j[axis, 1], j[axis, 2]
        a[axis, 0] = s[0] * x + s[1] * y + s[2] * z
        a[axis, 1] = s[1] * x + s[3] * y + s[4] * z
        a[axis, 2] = s[2] * x + s[4] * y + s[5] * z
    return (
        j[0, 0] * a[0, 0] + j[0, 1] * a[0, 1] + j[0, 2] * a[0, 2],
        j[1, 0] * a[0, 0] + j[1, 1] * a[0, 1] + j[1, 2] * a[0, 2],
        j[1, 0] * a[1, 0] + j[1, 1] * a[1, 1] + j[1, 2] * a[1, 2],
    )


@numba.njit(cache=True, parallel=True, error_model="numpy")
def project(
    own: tuple[np.ndarray, np.ndarray],
    cameras: tuple[np.ndarray, np.ndarray],
    screen: tuple[float, float, float, float],
    results: tuple[np.ndarray, ...],
) -> None:
    """Project N Gaussians into C pictures.

    Args:
        own: (N, 3) means, world units, and (N, 6) entries xx, xy, xz, yy, yz, zz of the
            covariances; float32 or float64, as all others.
        cameras: (C, 4, 4) camera from world, OpenCV axes, and (C, 3, 3) intrinsics.
        screen: width, height, near plane, variance of the screen filter.
        results: filled in: (C, N, 2) places, (C, N) depths, (C, N, 3) conics, (C, N) shares.
    """
    means, covariances = own
    viewmats, intrinsics = cameras
    places, depths, conics, shares = results
    near, blur = screen[2:]
    for chunk in prange((len(means) + CHUNK - 1) // CHUNK):
        j, a = np.empty((2, 3)), np.empty((2, 3))
        for c in range(len(viewmats)):
            view, lens = viewmats[c].astype(np.float64), intrinsics[c].astype(np.float64)
            for n in range(chunk * CHUNK, min(len(means), (chunk + 1) * CHUNK)):
                across, down, depth = seen(means[n], view)
                ahead = max(depth, near)
                slope_x, slope_y = across / ahead, down / ahead
                places[c, n, 0] = lens[0, 0] * slope_x + lens[0, 2]
                places[c, n, 1] = lens[1, 1] * slope_y + lens[1, 2]
                depths[c, n] = depth
                slopes = kept_slopes((slope_x, slope_y), lens, screen)
                scale = (lens[0, 0] / ahead, lens[1, 1] / ahead)
                xx, xy, yy = flattened(covariances[n], view, slopes, scale, j, a)
                before = xx * yy - xy * xy
                xx, yy = xx + blur, yy + blur
                area = xx * yy - xy * xy
                conics[c, n, 0], conics[c, n, 1] = yy / area, -xy / area
                conics[c, n, 2] = xx / area
                shares[c, n] = math.sqrt(min(max(before / area, SMALLEST_SHARE), 1.0))
