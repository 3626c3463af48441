"""Which Gaussian touches which band of rows of which picture: depth-ordered lists, by numba."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np

ROWS = 16
"""Rows of a band: what one thread draws at a time."""
FAINTEST = 1 / 255
"""Fainter than this a Gaussian is not drawn in a pixel."""


class Lists(NamedTuple):
    """Pairs of a band and a Gaussian, for C pictures of B bands.

    Attributes:
        starts: (C B + 1,) where the list of every band begins.
        gaussians: (P,) indices into all C N Gaussians, band after band, nearest first.
        levels: (C N,) a Gaussian is drawn where its Mahalanobis distance squared is at most this.
        first: (C N,) first row that a Gaussian touches.
        last: (C N,) last row; before the first where it touches none.
        slots: (C N + 1,) a Gaussian's pairs are numbered from here, upper band first.

    numba takes tuples with names, and nothing else with names.
    """

    starts: np.ndarray
    gaussians: np.ndarray
    levels: np.ndarray
    first: np.ndarray
    last: np.ndarray
    slots: np.ndarray


def listed(
    means: np.ndarray,
    conics: np.ndarray,
    opacities: np.ndarray,
    depths: np.ndarray,
    size: tuple[int, int],
    near_plane: float,
) -> Lists:
    """Return the lists of pictures of (width, height) pixels.

    Args:
        means: (C, N, 2) columns and rows, pixels.
        conics: (C, N, 3) xx, xy, yy, 1 / pixels squared.
        opacities: (C, N).
        depths: (C, N); what is nearer than the near plane is not drawn.
        size: width and height.
        near_plane: in the unit of the depths.
    """
    cameras, count = depths.shape
    bands = -(-size[1] // ROWS)
    levels = np.empty(cameras * count)
    first = np.empty(cameras * count, dtype=np.int32)
    last = np.empty(cameras * count, dtype=np.int32)
    _find_rows(
        means.reshape(-1, 2),
        conics.reshape(-1, 3),
        opacities.reshape(-1),
        depths.reshape(-1),
        *size,
        near_plane,
        levels,
        first,
        last,
    )
    # Stable: equal depths come in the order of the Gaussians, whatever the number of threads.
    order = np.argsort(depths, axis=1, kind="stable")
    starts = np.zeros(cameras * bands + 1, dtype=np.int64)
    slots = np.zeros(cameras * count + 1, dtype=np.int64)
    _count_pairs(first, last, count, bands, starts, slots)
    gaussians = np.empty(slots[-1], dtype=np.int32)
    _fill_lists(order, first, last, bands, starts, gaussians)
    return Lists(
        starts=starts, gaussians=gaussians, levels=levels, first=first, last=last, slots=slots
    )


@numba.njit(cache=True)
def _find_rows(
    means: np.ndarray,
    conics: np.ndarray,
    opacities: np.ndarray,
    depths: np.ndarray,
    width: int,
    height: int,
    near_plane: float,
    levels: np.ndarray,
    first: np.ndarray,
    last: np.ndarray,
) -> None:
    """Fill levels and rows; first 0 and last -1 where a Gaussian touches no pixel."""
    for g in range(len(depths)):
        levels[g], first[g], last[g] = -1.0, 0, -1
        a, b, c = np.float64(conics[g, 0]), np.float64(conics[g, 1]), np.float64(conics[g, 2])
        opacity, determinant = np.float64(opacities[g]), a * c - b * b
        # Written so that NaN is left out as well.
        if not (depths[g] > near_plane and opacity >= FAINTEST and determinant > 0):
            continue
        level = 2 * math.log(opacity / FAINTEST)
        across, down = math.sqrt(level * c / determinant), math.sqrt(level * a / determinant)
        x, y = np.float64(means[g, 0]), np.float64(means[g, 1])
        if not (x + across > 0 and x - across < width and y + down > 0 and y - down < height):
            continue
        levels[g] = level
        first[g] = max(0, math.ceil(max(y - down, 0.0) - 0.5))
        last[g] = min(height - 1, math.floor(min(y + down, float(height)) - 0.5))


@numba.njit(cache=True)
def _count_pairs(
    first: np.ndarray,
    last: np.ndarray,
    count: int,
    bands: int,
    starts: np.ndarray,
    slots: np.ndarray,
) -> None:
    """Fill the numbers where lists of bands and pairs of Gaussians begin."""
    for g in range(len(first)):
        pairs = 0
        if last[g] >= first[g]:
            base = (g // count) * bands
            for band in range(first[g] // ROWS, last[g] // ROWS + 1):
                starts[base + band + 1] += 1
                pairs += 1
        slots[g + 1] = slots[g] + pairs
    for band in range(1, len(starts)):
        starts[band] += starts[band - 1]


@numba.njit(cache=True)
def _fill_lists(
    order: np.ndarray,
    first: np.ndarray,
    last: np.ndarray,
    bands: int,
    starts: np.ndarray,
    gaussians: np.ndarray,
) -> None:
    """Write every Gaussian into the lists of its bands, nearest first."""
    cameras, count = order.shape
    ends = starts.copy()
    for camera in range(cameras):
        for place in range(count):
            g = camera * count + order[camera, place]
            if last[g] < first[g]:
                continue
            for band in range(first[g] // ROWS, last[g] // ROWS + 1):
                gaussians[ends[camera * bands + band]] = g
                ends[camera * bands + band] += 1


@numba.njit(cache=True)
def interval(a: float, b: float, c: float, level: float, x: float, down: float, width: int) -> Any:
    """First column and the one after the last where a dx^2 + 2 b dx dy + c dy^2 <= level.

    Args:
        a: xx of the conic, float64 as all others.
        b: xy.
        c: yy.
        level: the largest squared distance.
        x: column of the centre.
        down: dy, from the centre down to the row.
        width: of the picture.
    """
    inside = a * level - (a * c - b * b) * down * down
    if inside < 0:
        return 0, 0
    middle, reach = x - b / a * down, math.sqrt(inside) / a
    left = math.ceil(max(middle - reach, 0.0) - 0.5)
    right = math.floor(min(middle + reach, float(width)) - 0.5)
    return max(left, 0), min(right, width - 1) + 1
