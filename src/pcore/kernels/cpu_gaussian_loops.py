"""Blending of depth-ordered Gaussians, forward and backward, band by band of rows, by numba.

A pixel that is full is marked by a negative transmittance. The functions compute in the type of
their arrays, float32 or float64. What happens in a row of pixels is in `cpu_gaussian_rows`, and in
`cpu_disc_rows` for flat ones; numba chooses by the type.
"""

from __future__ import annotations

from functools import wraps
from types import ModuleType
from typing import Any

import numba
import numpy as np
from numba import prange
from numba.extending import overload

from pcore.kernels import cpu_disc_rows, cpu_gaussian_rows
from pcore.kernels.cpu_gaussian_lists import ROWS, Lists, interval, outline_of
from pcore.kernels.cpu_splats import Discs, Splats

_FAST = {"reassoc", "contract", "nsz"}
"""Sums over pixels may be formed eight at a time; NaN and infinity stay what they are."""


def draw_row(*given: Any) -> Any:
    """Of the module of what is drawn."""
    raise NotImplementedError


def row_backward(*given: Any) -> Any:
    """Of the module of what is drawn."""
    raise NotImplementedError


# numba wants the very names and annotations of what is returned, which both modules share.
@overload(draw_row, inline="always")
@wraps(cpu_gaussian_rows.draw_row)
def _draw_row(splats: Any, *_: Any) -> Any:
    return _rows_of(splats).draw_row


@overload(row_backward, inline="always")
@wraps(cpu_gaussian_rows.row_backward)
def _row_backward(splats: Any, *_: Any) -> Any:
    return _rows_of(splats).row_backward


def _rows_of(splats: Any) -> ModuleType:
    return cpu_disc_rows if splats.instance_class is Discs else cpu_gaussian_rows


@numba.njit(cache=True, parallel=True, fastmath=_FAST, error_model="numpy")
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
        image: (C, H, W, D) receives the sums of weight times colour.
        through: (C, H, W) ones; receives what is left of the light from behind.
        middle: (C, H, W) receives the index in all C N of the last that meets over half of it.
    """
    bands = (len(lists.starts) - 1) // len(image)
    height, width, numbers = image.shape[1:]
    for unit in prange(len(lists.starts) - 1):
        picture, left, halves = (
            image[unit // bands],
            through[unit // bands],
            middle[unit // bands],
        )
        top = (unit % bands) * ROWS
        bottom = min(top + ROWS, height)
        open_pixels = (bottom - top) * width
        planes = np.zeros((bottom - top, numbers, width), dtype=image.dtype)
        falloffs, weights, befores, _ = _memory(planes)
        for pair in range(lists.starts[unit], lists.starts[unit + 1]):
            g = lists.gaussians[pair]
            for row in range(max(lists.first[g], top), min(lists.last[g] + 1, bottom)):
                columns = _columns(splats, lists, g, row, width)
                if columns[0] < columns[1]:
                    open_pixels -= draw_row(
                        splats,
                        g,
                        lists.levels[g],
                        row,
                        columns,
                        left,
                        row - top,
                        planes,
                        halves,
                        falloffs,
                        weights,
                        befores,
                    )
            if open_pixels == 0:
                break
        for row in range(top, bottom):
            for column in range(width):
                left[row, column] = abs(left[row, column])
                for d in range(numbers):
                    picture[row, column, d] = planes[row - top, d, column]


@numba.njit(cache=True, parallel=True, fastmath=_FAST, error_model="numpy")
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
    height, width, numbers = to_image.shape[1:]
    for unit in prange(len(lists.starts) - 1):
        gradient, behind = to_image[unit // bands], rest[unit // bands]
        band = unit % bands
        top = band * ROWS
        bottom = min(top + ROWS, height)
        left = np.ones((bottom - top, width), dtype=to_image.dtype)
        planes = np.empty((bottom - top, numbers, width), dtype=to_image.dtype)
        falloffs, weights, befores, shown = _memory(planes)
        for row in range(top, bottom):
            for column in range(width):
                for d in range(numbers):
                    planes[row - top, d, column] = gradient[row, column, d]
        for pair in range(lists.starts[unit], lists.starts[unit + 1]):
            g = lists.gaussians[pair]
            slot = lists.slots[g] + band - lists.first[g] // ROWS
            of_pairs[slot] = 0
            for row in range(max(lists.first[g], top), min(lists.last[g] + 1, bottom)):
                columns = _columns(splats, lists, g, row, width)
                if columns[0] < columns[1]:
                    row_backward(
                        splats,
                        g,
                        lists.levels[g],
                        row,
                        columns,
                        left,
                        row - top,
                        planes,
                        behind,
                        of_pairs,
                        slot,
                        falloffs,
                        weights,
                        befores,
                        shown,
                    )


@numba.njit(cache=True)
def _columns(splats: Splats | Discs, lists: Lists, g: int, row: int, width: int) -> Any:
    x, y = splats.means[g, 0], splats.means[g, 1]
    return interval(outline_of(lists, g), lists.reaches[g], x, y, row, width)


@numba.njit(cache=True)
def _memory(planes: np.ndarray) -> Any:
    """Four times a row of pixels, of the type of planes (..., W)."""
    one = np.empty((4, planes.shape[-1]), dtype=planes.dtype)
    return one[0], one[1], one[2], one[3]


@numba.njit(cache=True, parallel=True)
def sum_pairs(of_pairs: np.ndarray, slots: np.ndarray, total: np.ndarray) -> None:
    """Sum the gradients of every Gaussian's pairs, in their order, into `total` (G, ...)."""
    for g in prange(len(total)):
        total[g] = 0
        for slot in range(slots[g], slots[g + 1]):
            for k in range(total.shape[1]):
                total[g, k] += of_pairs[slot, k]
