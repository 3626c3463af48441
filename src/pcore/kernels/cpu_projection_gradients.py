"""Gradients of the projection of Gaussians by numba.

Sums over Gaussians are taken chunk by chunk, so that they are the same for any number of threads.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numba import prange

from pcore.kernels.cpu_projection_loops import CHUNK, SMALLEST_SHARE, flattened, kept_slopes, seen


@numba.njit(cache=True, error_model="numpy")
def _to_covariance(
    values: tuple[float, float, float],
    blur: float,
    to_conic: np.ndarray,
    to_share: float,
) -> tuple[float, float, float]:
    """Gradient by the covariance before the filter, from those by the conic and the share."""
    xx, xy, yy = values
    before = xx * yy - xy * xy
    wide, high = xx + blur, yy + blur
    area = wide * high - xy * xy
    share = before / area
    to_before, to_area = 0.0, 0.0
    if SMALLEST_SHARE <= share <= 1.0:
        to_before = to_share / (2 * math.sqrt(share) * area)
        to_area = -to_before * share
    of_xx, of_xy, of_yy = to_conic[0] / area, to_conic[1] / area, to_conic[2] / area
    to_area -= (of_xx * high - of_xy * xy + of_yy * wide) / area
    return (
        of_yy + to_area * high + to_before * yy,
        -of_xy - 2 * xy * (to_area + to_before),
        of_xx + to_area * wide + to_before * xx,
    )


@numba.njit(cache=True, parallel=True, error_model="numpy")
def project_backward(
    own: tuple[np.ndarray, np.ndarray],
    cameras: tuple[np.ndarray, np.ndarray],
    screen: tuple[float, float, float, float],
    gradients: tuple[np.ndarray, ...],
    results: tuple[np.ndarray, ...],
) -> None:
    """Gradients of `cpu_projection_loops.project`.

    Args:
        own: see there.
        cameras: see there.
        screen: see there.
        gradients: by each of its results.
        results: (N, 3) by means and (N, 6) by covariances, which are filled in; and zeros
            (chunks, C, 4, 4) and (chunks, C, 3, 3), to which those by the cameras are added.
    """
    means, covariances = own
    viewmats, intrinsics = cameras
    to_means, to_covariances, to_cameras, to_lenses = results
    for chunk in prange((len(means) + CHUNK - 1) // CHUNK):
        work = np.empty((3, 2, 3))
        begin, end = chunk * CHUNK, min(len(means), (chunk + 1) * CHUNK)
        sums = np.zeros((end - begin, 9))
        for c in range(len(viewmats)):
            view, lens = viewmats[c].astype(np.float64), intrinsics[c].astype(np.float64)
            for n in range(begin, end):
                slopes = (
                    gradients[0][c, n],
                    gradients[1][c, n],
                    gradients[2][c, n],
                    gradients[3][c, n],
                )
                _one_backward(
                    (means[n], covariances[n], view, lens),
                    screen,
                    slopes,
                    work,
                    (sums[n - begin], to_cameras[chunk, c], to_lenses[chunk, c]),
                )
        for n in range(begin, end):
            for i in range(3):
                to_means[n, i] = sums[n - begin, i]
            for i in range(6):
                to_covariances[n, i] = sums[n - begin, 3 + i]


@numba.njit(cache=True, error_model="numpy")
def _one_backward(given: Any, screen: Any, gradients: Any, work: np.ndarray, results: Any) -> None:
    """Add the gradients of one Gaussian before one camera."""
    mean, covariance, view, lens = given
    to_place, to_depth, to_conic, to_share = gradients
    sums, to_view = results[:2]
    j, a, to_j = work[0], work[1], work[2]
    across, down, depth = seen(mean, view)
    ahead = max(depth, screen[2])
    slopes = (across / ahead, down / ahead)
    kept = kept_slopes(slopes, lens, screen)
    scale = (lens[0, 0] / ahead, lens[1, 1] / ahead)
    values = flattened(covariance, view, kept, scale, j, a)
    dxx, dxy, dyy = _to_covariance(values, screen[3], to_conic, to_share)
    entry = 3
    for i in range(3):
        to_j[0, i] = 2 * dxx * a[0, i] + dxy * a[1, i]
        to_j[1, i] = dxy * a[0, i] + 2 * dyy * a[1, i]
        for k in range(i, 3):
            twice = dxx * j[0, i] * j[0, k] + dyy * j[1, i] * j[1, k]
            mixed = dxy * (j[0, i] * j[1, k] + j[0, k] * j[1, i])
            sums[entry] += twice + mixed / 2 if i == k else 2 * twice + mixed
            entry += 1
    to_ahead = 0.0
    for axis in range(2):
        places = to_place[axis], slopes[axis], kept[axis], ahead
        to_ahead += _axis_backward(axis, (mean, view, lens), places, to_j, results)
    to_seen = to_depth + to_ahead if depth >= screen[2] else to_depth + 0.0
    for i in range(3):
        sums[i] += to_seen * view[2, i]
        to_view[2, i] += to_seen * mean[i]
    to_view[2, 3] += to_seen


@numba.njit(cache=True, error_model="numpy")
def _axis_backward(axis: int, given: Any, places: Any, to_j: np.ndarray, results: Any) -> float:
    """Add what one axis of the picture gives; return the gradient by the depth."""
    mean, view, lens = given
    to_place, slope, kept, ahead = places
    sums, to_view, to_lens = results
    focal = lens[axis, axis]
    scale = focal / ahead
    to_scale, to_kept = 0.0, 0.0
    for i in range(3):
        to_scale += to_j[axis, i] * (view[axis, i] - kept * view[2, i])
        to_kept -= scale * to_j[axis, i] * view[2, i]
        to_view[axis, i] += scale * to_j[axis, i]
        to_view[2, i] -= scale * kept * to_j[axis, i]
    to_slope = to_place * focal
    to_focal = to_place * slope + to_scale / ahead
    to_middle = to_place + 0.0
    if kept == slope:
        to_slope += to_kept
    else:
        # The ends of the slopes are the lens's.
        to_focal -= to_kept * kept / focal
        to_middle -= to_kept / focal
    to_lens[axis, axis] += to_focal
    to_lens[axis, 2] += to_middle
    to_row = to_slope / ahead
    for i in range(3):
        sums[i] += to_row * view[axis, i]
        to_view[axis, i] += to_row * mean[i]
    to_view[axis, 3] += to_row
    return -(to_scale * scale + to_slope * slope) / ahead
