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
        outlines: (C N, 6) the ellipse in which it is: column and row of the middle, conic xx, xy,
            yy, and the value of the conic there; a conic of zeros is the whole picture.
        reaches: (C N,) radius about the mean, pixels, in which it is drawn as well.
        first: (C N,) first row that a Gaussian touches.
        last: (C N,) last row; before the first where it touches none.
        slots: (C N + 1,) a Gaussian's pairs are numbered from here, upper band first.

    numba takes tuples with names, and nothing else with names.
    """

    starts: np.ndarray
    gaussians: np.ndarray
    levels: np.ndarray
    outlines: np.ndarray
    reaches: np.ndarray
    first: np.ndarray
    last: np.ndarray
    slots: np.ndarray


def listed(
    means: np.ndarray,
    shapes: np.ndarray,
    opacities: np.ndarray,
    depths: np.ndarray,
    size: tuple[int, int],
    near_plane: float,
    precision: float = 0.0,
) -> Lists:
    """Return the lists of pictures of (width, height) pixels.

    Args:
        means: (C, N, 2) columns and rows, pixels.
        shapes: (C, N, 3) conics xx, xy, yy, 1 / pixels squared; or (C, N, 6) maps of discs.
        opacities: (C, N).
        depths: (C, N); what is nearer than the near plane is not drawn.
        size: width and height.
        near_plane: in the unit of the depths.
        precision: of the round Gaussian that a disc never is smaller than, 1 / pixels squared; 0
            for none.
    """
    cameras, count = depths.shape
    bands = -(-size[1] // ROWS)
    levels, reaches = np.empty(cameras * count), np.zeros(cameras * count)
    outlines = np.zeros((cameras * count, 6))
    first = np.empty(cameras * count, dtype=np.int32)
    last = np.empty(cameras * count, dtype=np.int32)
    _find_rows(
        means.reshape(-1, 2),
        shapes.reshape(-1, shapes.shape[-1]),
        opacities.reshape(-1),
        depths.reshape(-1),
        size,
        near_plane,
        precision,
        levels,
        outlines,
        reaches,
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
        starts=starts,
        gaussians=gaussians,
        levels=levels,
        outlines=outlines,
        reaches=reaches,
        first=first,
        last=last,
        slots=slots,
    )


@numba.njit(cache=True)
def _find_rows(
    means: np.ndarray,
    shapes: np.ndarray,
    opacities: np.ndarray,
    depths: np.ndarray,
    size: tuple[int, int],
    near_plane: float,
    precision: float,
    levels: np.ndarray,
    outlines: np.ndarray,
    reaches: np.ndarray,
    first: np.ndarray,
    last: np.ndarray,
) -> None:
    """Fill levels, outlines and rows; first 0 and last -1 where a Gaussian touches no pixel."""
    width, height = size
    for g in range(len(depths)):
        levels[g], first[g], last[g] = -1.0, 0, -1
        opacity = np.float64(opacities[g])
        # Written so that NaN is left out as well.
        if not (depths[g] > near_plane and opacity >= FAINTEST):
            continue
        level = 2 * math.log(opacity / FAINTEST)
        x, y = np.float64(means[g, 0]), np.float64(means[g, 1])
        a, b, c, beside, below, rim = _outline(shapes[g], level)
        determinant = a * c - b * b
        if determinant > 0 and a > 0:
            across, down = math.sqrt(rim * c / determinant), math.sqrt(rim * a / determinant)
        elif shapes.shape[1] > 3 and a == 0:
            # A disc that reaches behind the camera: its outline is no ellipse.
            across, down = float(width) + abs(x), float(height) + abs(y)
        else:
            continue
        round_ = math.sqrt(level / precision) if precision > 0 else 0.0
        left, right = min(x + beside - across, x - round_), max(x + beside + across, x + round_)
        top, bottom = min(y + below - down, y - round_), max(y + below + down, y + round_)
        if not (right > 0 and left < width and bottom > 0 and top < height):
            continue
        levels[g], reaches[g] = level, round_
        outlines[g] = x + beside, y + below, a, b, c, rim
        first[g] = max(0, math.ceil(max(top, 0.0) - 0.5))
        last[g] = min(height - 1, math.floor(min(bottom, float(height)) - 0.5))


@numba.njit(cache=True)
def _outline(shape: np.ndarray, level: float) -> Any:
    """Conic a, b, c, offset of its middle from the mean, and its value on the rim.

    Of a disc |P d|^2 <= L (1 + w . d)^2, with S = P^T P - L w w^T: (d - e)^T S (d - e) <= r, where
    e = L S^-1 w and r = L + e^T S e.
    """
    if len(shape) == 3:
        return np.float64(shape[0]), np.float64(shape[1]), np.float64(shape[2]), 0.0, 0.0, level
    px, py, qx, qy = (
        np.float64(shape[0]),
        np.float64(shape[1]),
        np.float64(shape[2]),
        np.float64(shape[3]),
    )
    wx, wy = np.float64(shape[4]), np.float64(shape[5])
    a = px * px + qx * qx - level * wx * wx
    b = px * py + qx * qy - level * wx * wy
    c = py * py + qy * qy - level * wy * wy
    determinant = a * c - b * b
    if not (determinant > 0 and a > 0):
        nothing = 0.0 * determinant  # NaN stays NaN.
        return nothing, nothing, nothing, nothing, nothing, nothing
    beside = level * (c * wx - b * wy) / determinant
    below = level * (a * wy - b * wx) / determinant
    return a, b, c, beside, below, level + level * (wx * beside + wy * below)


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
def interval(outline: Any, reach: float, x: Any, y: Any, row: int, width: int) -> Any:
    """First column in which a Gaussian is drawn in a row, and the one after the last.

    Args:
        outline: six numbers, see `Lists`.
        reach: see there.
        x: column of the mean.
        y: row of the mean.
        row: of the picture.
        width: of the picture.
    """
    middle, top, a, b, c, rim = outline
    if a == 0:
        return 0, width
    down = row + 0.5 - top
    inside = a * rim - (a * c - b * b) * down * down
    begin, end = width, 0
    if inside >= 0:
        begin, end = _columns(middle - b / a * down, math.sqrt(inside) / a, width)
    if reach > 0:
        down = row + 0.5 - np.float64(y)
        inside = reach * reach - down * down
        if inside >= 0:
            left, right = _columns(np.float64(x), math.sqrt(inside), width)
            begin, end = min(begin, left), max(end, right)
    return begin, end


@numba.njit(cache=True)
def outline_of(lists: Lists, g: int) -> Any:
    """The outline of one Gaussian as six numbers."""
    row = lists.outlines[g]
    return row[0], row[1], row[2], row[3], row[4], row[5]


@numba.njit(cache=True)
def _columns(middle: float, reach: float, width: int) -> Any:
    left = math.ceil(max(middle - reach, 0.0) - 0.5)
    right = math.floor(min(middle + reach, float(width)) - 0.5)
    return max(left, 0), min(right, width - 1) + 1
