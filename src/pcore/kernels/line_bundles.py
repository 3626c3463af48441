"""Lines in bundles: how they are split, and the tube that holds a bundle inside the cloud."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np

LEAF = 16
"""Rays of a bundle that is not split further."""
_SAMPLES = 16
"""Rays that decide where a bundle is split."""
_LEAST_COSINE = 0.5
"""Bundles with a line farther from the axis than this get no bounds: they would drop nothing."""
_ROUNDING = 64 * float(np.finfo(np.float32).eps)
"""Distances in float32 are wrong by up to some multiples of eps times the largest length; this is
an order of magnitude more than was seen."""
_OVERFLOW = 1e15
"""Lengths up to which float32 can add up squares."""
_TINY = np.float32(1e-30)


class Tube(NamedTuple):
    """What holds a bundle: an axis, and at every position z along it the largest of two chords.

    Attributes:
        foot: (3,) a point of the axis, where z is 0.
        axis: (3,) its unit direction.
        base: spread at z = 0 by the chord before the waist.
        slope: how that chord grows with z.
        base_after: the same of the chord behind the waist.
        slope_after: the same.
        cosine: least cosine between a line and the axis; 0 where there are no bounds.
    """

    foot: np.ndarray
    axis: np.ndarray
    base: np.float32
    slope: np.float32
    base_after: np.float32
    slope_after: np.float32
    cosine: np.float32


@numba.njit(cache=True, error_model="numpy")
def as_lines(origins: np.ndarray, directions: np.ndarray, box: np.ndarray) -> Any:
    """Lines by their point nearest to the cloud's centre, relative to it, and their direction.

    Args:
        origins: (R, 3) of the rays.
        directions: (R, 3).
        box: (2, 3) least and greatest coordinates of the cloud.

    Returns:
        The lines (R, 6), the centre (3,), the radius of the cloud, and the margin: how far bounds
        and computed distances may be apart, or infinity where bounds cannot be computed.
    """
    centre = np.float32(0.5) * (box[0] + box[1])
    radius = np.float32(0.5) * np.sqrt(((box[1] - box[0]) ** 2).sum())
    lines = np.empty((origins.shape[0], 6), dtype=np.float32)
    farthest, skew, checksum = 0.0, 0.0, 0.0
    for ray in range(origins.shape[0]):
        x, y, z = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        u, v, w = (
            origins[ray, 0] - centre[0],
            origins[ray, 1] - centre[1],
            origins[ray, 2] - centre[2],
        )
        along = u * x + v * y + w * z
        lines[ray, 0], lines[ray, 1], lines[ray, 2] = u - along * x, v - along * y, w - along * z
        lines[ray, 3], lines[ray, 4], lines[ray, 5] = x, y, z
        length, error = u * u + v * v + w * w, abs(x * x + y * y + z * z - 1.0)
        farthest, skew = max(farthest, length), max(skew, error)
        checksum += length + error
    reach = np.abs(box).sum() + np.sqrt(farthest)
    # Directions that are not quite of unit length change distances by that part of the length.
    margin = reach * (_ROUNDING + 2.0 * skew)
    # Maxima may overlook NaN; sums do not.
    if not (reach < _OVERFLOW and checksum < np.inf):
        margin = np.inf
    return lines, centre, radius, np.float32(margin)


@numba.njit(cache=True)
def cut(lines: np.ndarray, order: np.ndarray, radius: float, parts: int) -> np.ndarray:
    """Split the lines into about that many bundles; return where they begin, and the end."""
    borders = [0, lines.shape[0]]
    while len(borders) <= parts:
        finer = [0]
        for i in range(len(borders) - 1):
            if borders[i + 1] - borders[i] > LEAF:
                finer.append(split(lines, order, radius, borders[i], borders[i + 1]))
            finer.append(borders[i + 1])
        if len(finer) == len(borders):
            break
        borders = finer
    return np.array(borders)


@numba.njit(cache=True)
def split(lines: np.ndarray, order: np.ndarray, radius: float, start: int, stop: int) -> int:
    """Sort the lines of a bundle, and `order` with them, into the halves of its widest extent.

    Returns:
        Where the second half begins; neither is empty.
    """
    step = max(1, (stop - start) // _SAMPLES)
    widest, extent, border = 0, np.float32(-1.0), np.float32(0.0)
    for axis in range(6):
        low = high = lines[start, axis]
        for ray in range(start, stop, step):
            low, high = min(low, lines[ray, axis]), max(high, lines[ray, axis])
        # A difference of directions moves lines apart by that part of the cloud's radius.
        reach = (high - low) * (radius if axis >= 3 else np.float32(1.0))
        if reach > extent:
            widest, extent, border = axis, reach, np.float32(0.5) * (low + high)
    i, j = start, stop - 1
    while i <= j:
        if lines[i, widest] < border:
            i += 1
            continue
        order[i], order[j] = order[j], order[i]
        for axis in range(6):
            lines[i, axis], lines[j, axis] = lines[j, axis], lines[i, axis]
        j -= 1
    # Equal lines, and those that are no numbers, are halved as they come.
    return i if start < i < stop else (start + stop) // 2


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def enclose(lines: np.ndarray, centre: np.ndarray, radius: float) -> Any:
    """Find the tube of a bundle; one without bounds where its lines differ too much.

    The spread is convex in z, so chords bound it from above: two of them, between the ends of the
    cloud and the waist, where the lines come closest to each other (least squares).
    """
    foot, axis = np.zeros(3, dtype=np.float32), np.zeros(3, dtype=np.float32)
    across = np.empty((6, lines.shape[0]), dtype=np.float32)
    cosine, none = _across(lines, foot, axis, across), np.float32(0.0)
    foot += centre
    if cosine <= _LEAST_COSINE:
        return Tube(foot, axis, none, none, none, none, none)
    uw, ww = np.float32(0.0), _TINY
    for ray in range(lines.shape[0]):
        for i in range(3):
            uw += across[i, ray] * across[3 + i, ray]
            ww += across[3 + i, ray] ** 2
    end = np.float32(0.98) * radius
    waist = min(max(-uw / ww, -end), end)
    low, middle, high = _spread(across, -radius), _spread(across, waist), _spread(across, radius)
    before = (middle - low) / (waist + radius + _TINY)
    after = (high - middle) / (radius - waist + _TINY)
    return Tube(
        foot,
        axis,
        np.float32(middle - waist * before),
        np.float32(before),
        np.float32(middle - waist * after),
        np.float32(after),
        cosine,
    )


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _across(lines: np.ndarray, foot: np.ndarray, axis: np.ndarray, across: np.ndarray) -> Any:
    """Write the axis, and the lines as u + z w across it; return the least cosine."""
    n = lines.shape[0]
    for ray in range(n):
        for i in range(3):
            foot[i] += lines[ray, i] / np.float32(n)
            axis[i] += lines[ray, 3 + i] / np.float32(n)
    length = np.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    if length <= _LEAST_COSINE:
        return np.float32(0.0)
    axis /= length
    foot -= (foot[0] * axis[0] + foot[1] * axis[1] + foot[2] * axis[2]) * axis
    least = np.float32(1.0)
    for ray in range(n):
        cosine, along = np.float32(0.0), np.float32(0.0)
        for i in range(3):
            cosine += lines[ray, 3 + i] * axis[i]
            along += (lines[ray, i] - foot[i]) * axis[i]
        least = min(least, cosine)
        for i in range(3):
            slope = lines[ray, 3 + i] / cosine
            across[i, ray] = lines[ray, i] - foot[i] - along * slope
            across[3 + i, ray] = slope - axis[i]
    return least


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _spread(across: np.ndarray, z: Any) -> Any:
    """Largest distance from the axis at z."""
    largest = np.float32(0.0)
    for ray in range(across.shape[1]):
        x = across[0, ray] + z * across[3, ray]
        y = across[1, ray] + z * across[4, ray]
        t = across[2, ray] + z * across[5, ray]
        largest = max(largest, x * x + y * y + t * t)
    return np.sqrt(largest)
