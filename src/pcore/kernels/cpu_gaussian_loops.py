"""Blending of depth-ordered Gaussians, forward and backward, band by band of rows, by numba.

A pixel that is full is marked by a negative transmittance. The functions compute in the type of
their arrays, float32 or float64.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numba import prange

from pcore.kernels.cpu_gaussian_lists import ROWS, Lists, interval, outline_of
from pcore.kernels.cpu_gaussian_meets import Discs, Splats, added, like, met, shape_of, sums

MOST_OPAQUE = 0.999
"""Greatest opacity of a Gaussian in a pixel."""
FULL = 1e-4
"""A pixel is full before its transmittance falls to this."""
HALF = 0.5
"""Transmittance up to which what a pixel shows lies in front of its median."""


@numba.njit(cache=True, parallel=True)
def blend(
    splats: Splats | Discs,
    lists: Lists,
    image: np.ndarray,
    through: np.ndarray,
    middle: np.ndarray,
) -> None:
    """Draw.

    Args:
        splats: what is drawn.
        lists: in which order where.
        image: (C, H, W, D) zeros; receives the sums of weight times colour.
        through: (C, H, W) ones; receives what is left of the light from behind.
        middle: (C, H, W) receives the index in all C N of the last that meets over half of it.
    """
    bands = (len(lists.starts) - 1) // len(image)
    height = image.shape[1]
    for unit in prange(len(lists.starts) - 1):
        picture, left, halves = (
            image[unit // bands],
            through[unit // bands],
            middle[unit // bands],
        )
        top = (unit % bands) * ROWS
        bottom = min(top + ROWS, height)
        open_pixels = (bottom - top) * image.shape[2]
        for pair in range(lists.starts[unit], lists.starts[unit + 1]):
            g = lists.gaussians[pair]
            where = outline_of(lists, g), lists.reaches[g], lists.levels[g]
            for row in range(max(lists.first[g], top), min(lists.last[g] + 1, bottom)):
                open_pixels -= _blend_row(
                    splats, g, where, row, left[row], picture[row], halves[row]
                )
            if open_pixels == 0:
                break
        for row in range(top, bottom):
            for column in range(image.shape[2]):
                left[row, column] = abs(left[row, column])


@numba.njit(cache=True)
def _blend_row(
    splats: Splats | Discs,
    g: int,
    where: Any,
    row: int,
    left: np.ndarray,
    colors: np.ndarray,
    middle: np.ndarray,
) -> int:
    """Draw one Gaussian into one row; return how many pixels it filled."""
    opacity, color = splats.opacities[g], splats.colors[g]
    x, y = splats.means[g, 0], splats.means[g, 1]
    shape, deep = shape_of(splats, g)
    outline, reach, level = where
    begin, end = interval(outline, reach, x, y, row, len(left))
    one, most, full = like(1.0, opacity), like(MOST_OPAQUE, opacity), like(FULL, opacity)
    half = like(HALF, opacity)
    dy = like(row + 0.5, opacity) - y
    filled = 0
    for column in range(begin, end):
        before = left[column]
        if before < 0:
            continue
        falloff, _, _, nearer = met(shape, level, like(column + 0.5, opacity) - x, dy)
        alpha = min(opacity * falloff, most)
        after = before * (one - alpha)
        if after <= full:
            left[column] = -before
            filled += 1
            continue
        weight = alpha * before
        for d in range(len(color)):
            colors[column, d] += weight * color[d]
        if deep:
            colors[column, -1] += weight * color[-1] * (nearer - one)
        if weight > 0 and before > half:
            middle[column] = g
        left[column] = after
    return filled


@numba.njit(cache=True, parallel=True)
def blend_backward(
    splats: Splats | Discs,
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
        of_pairs: (P, 2 + S + 1 + D) receives the gradients of mean, shape, opacity and colour.
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
            where = outline_of(lists, g), lists.reaches[g], lists.levels[g]
            found = of_pairs[lists.slots[g] + band - lists.first[g] // ROWS]
            found[:] = 0
            for row in range(max(lists.first[g], top), min(lists.last[g] + 1, bottom)):
                _row_backward(
                    splats, g, where, row, left[row - top], gradient[row], behind[row], found
                )


@numba.njit(cache=True)
def _row_backward(
    splats: Splats | Discs,
    g: int,
    where: Any,
    row: int,
    left: np.ndarray,
    gradient: np.ndarray,
    behind: np.ndarray,
    found: np.ndarray,
) -> None:
    """Add the gradient of one Gaussian in one row of pixels to `found` (2 + S + 1 + D)."""
    opacity, color = splats.opacities[g], splats.colors[g]
    x, y = splats.means[g, 0], splats.means[g, 1]
    shape, deep = shape_of(splats, g)
    outline, reach, level = where
    begin, end = interval(outline, reach, x, y, row, len(left))
    one, most, full = like(1.0, opacity), like(MOST_OPAQUE, opacity), like(FULL, opacity)
    to_opacity = to_nearer = none = like(0.0, opacity)
    total, dy = sums(shape), like(row + 0.5, opacity) - y
    start = len(found) - len(color)
    for column in range(begin, end):
        before = left[column]
        if before < 0:
            continue
        dx = like(column + 0.5, opacity) - x
        place = met(shape, level, dx, dy)
        falloff, nearer = place[0], place[3]
        alpha = min(opacity * falloff, most)
        after = before * (one - alpha)
        if after <= full:
            left[column] = -before
            continue
        weight, shown = alpha * before, none
        for d in range(len(color)):
            found[start + d] += weight * gradient[column, d]
            shown += gradient[column, d] * color[d]
        if deep:
            to_nearer = gradient[column, -1] * color[-1]
            shown += to_nearer * (nearer - one)
            found[-1] += weight * gradient[column, -1] * (nearer - one)
            to_nearer *= weight
        behind[column] -= weight * shown
        left[column] = after
        to_alpha = before * shown - behind[column] / (one - alpha)
        if opacity * falloff >= most:
            to_alpha = none
        to_opacity += to_alpha * falloff
        total = added(shape, total, (dx, dy), place, -alpha * to_alpha, to_nearer)
    for k in range(len(total)):
        found[k] += total[k]
    found[start - 1] += to_opacity


@numba.njit(cache=True, parallel=True)
def sum_pairs(of_pairs: np.ndarray, slots: np.ndarray, total: np.ndarray) -> None:
    """Sum the gradients of every Gaussian's pairs, in their order, into `total` (G, ...)."""
    for g in prange(len(total)):
        total[g] = 0
        for slot in range(slots[g], slots[g + 1]):
            for k in range(total.shape[1]):
                total[g, k] += of_pairs[slot, k]
