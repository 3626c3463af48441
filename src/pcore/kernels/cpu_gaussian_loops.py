"""Blending of depth-ordered Gaussians, forward and backward, band by band of rows, by numba.

A pixel that is full is marked by a negative transmittance. The functions compute in the type of
their arrays, float32 or float64.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import prange

from pcore.kernels.cpu_gaussian_lists import ROWS, Lists, interval

MOST_OPAQUE = 0.999
"""Greatest opacity of a Gaussian in a pixel."""
FULL = 1e-4
"""A pixel is full before its transmittance falls to this."""


class Splats(NamedTuple):
    """The G Gaussians of all pictures: means (G, 2), conics (G, 3), opacities (G,), colours (G, D).

    In pixels; float32 or float64, all the same.
    """

    means: np.ndarray
    conics: np.ndarray
    opacities: np.ndarray
    colors: np.ndarray


@numba.njit(cache=True, parallel=True)
def blend(splats: Splats, lists: Lists, image: np.ndarray, through: np.ndarray) -> None:
    """Draw.

    Args:
        splats: what is drawn.
        lists: in which order where.
        image: (C, H, W, D) zeros; receives the sums of weight times colour.
        through: (C, H, W) ones; receives what is left of the light from behind.
    """
    bands = (len(lists.starts) - 1) // len(image)
    height = image.shape[1]
    for unit in prange(len(lists.starts) - 1):
        picture, left = image[unit // bands], through[unit // bands]
        top = (unit % bands) * ROWS
        bottom = min(top + ROWS, height)
        open_pixels = (bottom - top) * image.shape[2]
        for pair in range(lists.starts[unit], lists.starts[unit + 1]):
            g = lists.gaussians[pair]
            for row in range(max(lists.first[g], top), min(lists.last[g] + 1, bottom)):
                open_pixels -= _blend_row(splats, g, lists.levels[g], row, left[row], picture[row])
            if open_pixels == 0:
                break
        for row in range(top, bottom):
            for column in range(image.shape[2]):
                left[row, column] = abs(left[row, column])


@numba.njit(cache=True)
def _blend_row(
    splats: Splats, g: int, level: Any, row: int, left: np.ndarray, colors: np.ndarray
) -> int:
    """Draw one Gaussian into one row; return how many pixels it filled."""
    mean, conic, opacity, color = (
        splats.means[g],
        splats.conics[g],
        splats.opacities[g],
        splats.colors[g],
    )
    begin, end = _columns(mean, conic, level, row, len(left))
    one, most, full = _like(1.0, opacity), _like(MOST_OPAQUE, opacity), _like(FULL, opacity)
    filled = 0
    for column in range(begin, end):
        before = left[column]
        if before < 0:
            continue
        alpha = min(opacity * _falloff(mean, conic, row, column), most)
        after = before * (one - alpha)
        if after <= full:
            left[column] = -before
            filled += 1
            continue
        weight = alpha * before
        for d in range(len(color)):
            colors[column, d] += weight * color[d]
        left[column] = after
    return filled


@numba.njit(cache=True, parallel=True)
def blend_backward(
    splats: Splats,
    lists: Lists,
    to_image: np.ndarray,
    rest: np.ndarray,
    of_pairs: np.ndarray,
) -> None:
    """Walk from front to back again, and write the gradient of every pair.

    With T the transmittance before a Gaussian, c its colour, g the gradient of the pixel and r what
    <g, C> still gets from behind: dL / d alpha = T <g, c> - (r + T_end dL / dT_end) / (1 - alpha).

    Args:
        splats: what was drawn.
        lists: in which order where.
        to_image: (C, H, W, D) gradient of the picture.
        rest: (C, H, W) <g, C> of the finished pixel plus T_end dL / dT_end; overwritten.
        of_pairs: (P, 6 + D) receives the gradients of mean, conic, opacity and colour.
    """
    bands = (len(lists.starts) - 1) // len(to_image)
    height, width = to_image.shape[1], to_image.shape[2]
    for unit in prange(len(lists.starts) - 1):
        gradient, behind = to_image[unit // bands], rest[unit // bands]
        band = unit % bands
        top = band * ROWS
        bottom = min(top + ROWS, height)
        left = np.ones((bottom - top, width), dtype=to_image.dtype)
        for pair in range(lists.starts[unit], lists.starts[unit + 1]):
            g = lists.gaussians[pair]
            found = of_pairs[lists.slots[g] + band - lists.first[g] // ROWS]
            found[:] = 0
            for row in range(max(lists.first[g], top), min(lists.last[g] + 1, bottom)):
                _row_backward(
                    splats,
                    g,
                    lists.levels[g],
                    row,
                    left[row - top],
                    gradient[row],
                    behind[row],
                    found,
                )


@numba.njit(cache=True)
def _row_backward(
    splats: Splats,
    g: int,
    level: Any,
    row: int,
    left: np.ndarray,
    gradient: np.ndarray,
    behind: np.ndarray,
    found: np.ndarray,
) -> None:
    """Add the gradient of one Gaussian in one row of pixels to `found` (6 + D)."""
    mean, conic, opacity, color = (
        splats.means[g],
        splats.conics[g],
        splats.opacities[g],
        splats.colors[g],
    )
    begin, end = _columns(mean, conic, level, row, len(left))
    one, most = _like(1.0, opacity), _like(MOST_OPAQUE, opacity)
    to_x = to_y = to_xx = to_xy = to_yy = to_opacity = _like(0.0, opacity)
    dy = _like(row + 0.5, opacity) - mean[1]
    for column in range(begin, end):
        before = left[column]
        if before < 0:
            continue
        falloff = _falloff(mean, conic, row, column)
        alpha = min(opacity * falloff, most)
        after = before * (one - alpha)
        if after <= _like(FULL, opacity):
            left[column] = -before
            continue
        weight, shown = alpha * before, _like(0.0, opacity)
        for d in range(len(color)):
            found[6 + d] += weight * gradient[column, d]
            shown += gradient[column, d] * color[d]
        behind[column] -= weight * shown
        left[column] = after
        if opacity * falloff >= most:
            continue
        to_alpha = before * shown - behind[column] / (one - alpha)
        to_opacity += to_alpha * falloff
        dx = _like(column + 0.5, opacity) - mean[0]
        to_square = _like(-0.5, opacity) * alpha * to_alpha
        to_xx += to_square * dx * dx
        to_xy += to_square * dx * dy
        to_yy += to_square * dy * dy
        to_x -= to_square * (conic[0] * dx + conic[1] * dy)
        to_y -= to_square * (conic[1] * dx + conic[2] * dy)
    two = _like(2.0, opacity)
    found[0] += two * to_x
    found[1] += two * to_y
    found[2] += to_xx
    found[3] += two * to_xy
    found[4] += to_yy
    found[5] += to_opacity


@numba.njit(cache=True, parallel=True)
def sum_pairs(of_pairs: np.ndarray, slots: np.ndarray, total: np.ndarray) -> None:
    """Sum the gradients of every Gaussian's pairs, in their order, into `total` (G, 6 + D)."""
    for g in prange(len(total)):
        total[g] = 0
        for slot in range(slots[g], slots[g + 1]):
            for k in range(total.shape[1]):
                total[g, k] += of_pairs[slot, k]


@numba.njit(cache=True)
def _like(value: float, other: Any) -> Any:
    """A number of the type of another: float32 would become float64 beside a literal."""
    return type(other)(value)


@numba.njit(cache=True)
def _columns(mean: np.ndarray, conic: np.ndarray, level: Any, row: int, width: int) -> Any:
    return interval(
        np.float64(conic[0]),
        np.float64(conic[1]),
        np.float64(conic[2]),
        level,
        np.float64(mean[0]),
        row + 0.5 - np.float64(mean[1]),
        width,
    )


@numba.njit(cache=True)
def _falloff(mean: np.ndarray, conic: np.ndarray, row: int, column: int) -> Any:
    """exp(-d^2 / 2) at the centre of a pixel."""
    dx = _like(column + 0.5, mean[0]) - mean[0]
    dy = _like(row + 0.5, mean[0]) - mean[1]
    square = conic[0] * dx * dx + _like(2.0, dx) * conic[1] * dx * dy + conic[2] * dy * dy
    return math.exp(_like(-0.5, dx) * square)
