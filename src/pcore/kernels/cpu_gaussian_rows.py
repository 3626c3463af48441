"""One Gaussian in one row of pixels, forward and backward, several pixels at a time, by numba.

Loops over pixels have no branches and no calls and colours lie in planes, so that the compiler
takes eight pixels of float32 at once. A pixel that is full has a negative transmittance.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numba.extending import overload

from pcore.kernels.cpu_splats import FULL, HALF, MOST_OPAQUE, Splats, like

_LOG2 = np.float32(1 / math.log(2))
_LN2_HIGH, _LN2_LOW = np.float32(0.693359375), np.float32(-2.12194440e-4)
"""ln 2 in two parts, of which the first has few digits."""
_HALF = np.float32(0.5)
_SERIES = tuple(np.float32(1 / math.factorial(n)) for n in range(8))
_LEAST = np.float32(-80.0)


def exponential(power: Any) -> Any:
    """The exponential of what is not above 0; of float32 without a call, to 1e-7 down to -6."""
    raise NotImplementedError


@overload(exponential)
def _exponential(power: Any) -> Any:
    def single(power: Any) -> Any:
        power = max(power, _LEAST)
        steps = np.int32(power * _LOG2 - _HALF)
        whole = np.float32(steps)
        rest = (power - whole * _LN2_HIGH) - whole * _LN2_LOW
        value = _SERIES[7] * rest + _SERIES[6]
        value = value * rest + _SERIES[5]
        value = value * rest + _SERIES[4]
        value = value * rest + _SERIES[3]
        value = value * rest + _SERIES[2]
        value = value * rest + _SERIES[1]
        value = value * rest + _SERIES[0]
        # Times 2 to the steps, which are added to the exponent.
        more = steps << np.int32(23)
        return np.int32(np.float32(value).view(np.int32) + more).view(np.float32)

    def double(power: Any) -> Any:
        return math.exp(power)

    return single if power == numba.float32 else double


def draw_row(
    splats: Any,
    g: int,
    level: float,
    row: int,
    columns: tuple[int, int],
    left: np.ndarray,
    at: int,
    planes: np.ndarray,
    middle: np.ndarray,
    falloffs: np.ndarray,
    weights: np.ndarray,
    befores: np.ndarray,
) -> int:
    """Draw a Gaussian into a part of a row; return how many pixels it filled.

    Args:
        splats: what is drawn.
        g: which of them.
        level: of discs.
        row: of the picture.
        columns: the first, and the one after the last.
        left: (H, W) what is left of the light from behind, updated.
        at: row of `planes`.
        planes: (R, D, W) sums of weight times colour, updated.
        middle: (H, W) the last that meets over half of the light, updated.
        falloffs: (W,) memory, as `weights` and `befores`.
        weights: memory.
        befores: memory.
    """
    begin, end = columns
    shape = splats.shapes[g, 0], splats.shapes[g, 1], splats.shapes[g, 2], splats.opacities[g]
    place = _place(splats, g, row, begin)
    filled = _meet(shape, place, begin, end, left, row, falloffs, weights, befores)
    for d in range(planes.shape[1]):
        _add(planes, at, d, begin, end, weights, splats.colors[g, d])
    half = like(HALF, shape[0])
    for k in range(end - begin):
        if weights[k] > 0 and befores[k] > half:
            middle[row, begin + k] = g
    return filled


@numba.njit(inline="always")
def _place(splats: Splats, g: int, row: int, begin: int) -> Any:
    """From the mean to the middle of the first pixel, columns and rows."""
    x, y = splats.means[g, 0], splats.means[g, 1]
    return like(begin + 0.5, x) - x, like(row + 0.5, y) - y


@numba.njit(inline="always")
def _meet(
    shape: Any,
    place: Any,
    begin: int,
    end: int,
    left: np.ndarray,
    row: int,
    falloffs: np.ndarray,
    weights: np.ndarray,
    befores: np.ndarray,
) -> int:
    """Take the share of a Gaussian from the light of pixels; return how many it filled.

    `befores` is 0 where nothing is drawn.
    """
    (a, b, c, opacity), (start, dy) = shape, place
    one, most, full = like(1.0, a), like(MOST_OPAQUE, a), like(FULL, a)
    filled = none = like(0.0, a)
    first, second = like(-0.5, a) * a, -b * dy
    last = like(-0.5, a) * c * dy * dy
    first_column = np.uint64(begin)
    for k in range(np.uint64(end - begin)):
        dx = like(float(np.int32(k)), a) + start
        falloff = exponential((first * dx + second) * dx + last)
        alpha = min(opacity * falloff, most)
        before = left[row, first_column + k]
        after = before * (one - alpha)
        drawn = after > full
        falloffs[k] = falloff
        weights[k] = alpha * before if drawn else none
        befores[k] = before if drawn else none
        filled += none if drawn or before < 0 else one
        left[row, first_column + k] = after if drawn else -abs(before)
    return int(filled)


@numba.njit(inline="always")
def _add(
    planes: np.ndarray, at: int, d: int, begin: int, end: int, weights: np.ndarray, color: Any
) -> None:
    none = like(0.0, color)
    first_column = np.uint64(begin)
    for k in range(np.uint64(end - begin)):
        # Not 0 times a colour, which may be infinite behind what hides it.
        share = weights[k] * color if weights[k] > 0 else none
        planes[at, d, first_column + k] += share


def row_backward(
    splats: Any,
    g: int,
    level: float,
    row: int,
    columns: tuple[int, int],
    left: np.ndarray,
    at: int,
    gradient: np.ndarray,
    behind: np.ndarray,
    found: np.ndarray,
    slot: int,
    falloffs: np.ndarray,
    weights: np.ndarray,
    befores: np.ndarray,
    shown: np.ndarray,
) -> None:
    """Add the gradient of one Gaussian in a part of a row to a row of `found` (2 + 3 + 1 + D).

    Args:
        splats: what was drawn.
        g: which of them.
        level: of discs.
        row: of the picture.
        columns: the first, and the one after the last.
        left: (R, W) as for `draw_row`, of the band.
        at: row of `left` and `gradient`.
        gradient: (R, D, W) of the picture.
        behind: (H, W) what <gradient, colour> still gets from behind, updated.
        found: (P, 2 + 3 + 1 + D) receives sums for mean, conic, opacity and colour.
        slot: row of `found`.
        falloffs: (W,) memory, as the others.
        weights: memory.
        befores: memory.
        shown: memory.
    """
    begin, end = columns
    shape = splats.shapes[g, 0], splats.shapes[g, 1], splats.shapes[g, 2], splats.opacities[g]
    place = _place(splats, g, row, begin)
    _meet(shape, place, begin, end, left, at, falloffs, weights, befores)
    shown[: end - begin] = 0
    for d in range(gradient.shape[1]):
        color = splats.colors[g, d]
        found[slot, 6 + d] += _of_color(gradient, at, d, begin, end, weights, color, shown)
    to_opacity, still, across, wide = _of_shape(
        shape, place, begin, end, behind, row, falloffs, weights, befores, shown
    )
    (a, b, c, _), (_, dy) = shape, place
    half = like(0.5, a)
    found[slot, 0] -= a * across + b * dy * still
    found[slot, 1] -= b * across + c * dy * still
    found[slot, 2] += half * wide
    found[slot, 3] += dy * across
    found[slot, 4] += half * dy * dy * still
    found[slot, 5] += to_opacity


@numba.njit(inline="always")
def _of_color(
    gradient: np.ndarray,
    at: int,
    d: int,
    begin: int,
    end: int,
    weights: np.ndarray,
    color: Any,
    shown: np.ndarray,
) -> Any:
    """The derivative by one colour; adds to `shown` what the loss gets of it."""
    total = none = like(0.0, color)
    first_column = np.uint64(begin)
    for k in range(np.uint64(end - begin)):
        value = gradient[at, d, first_column + k]
        total += weights[k] * value if weights[k] > 0 else none
        shown[k] += value * color
    return total


@numba.njit(inline="always")
def _of_shape(
    shape: Any,
    place: Any,
    begin: int,
    end: int,
    behind: np.ndarray,
    row: int,
    falloffs: np.ndarray,
    weights: np.ndarray,
    befores: np.ndarray,
    shown: np.ndarray,
) -> Any:
    """Derivatives by the opacity and by the square, the latter times 1, dx and dx squared."""
    (a, _, _, opacity), (start, _) = shape, place
    one, most = like(1.0, a), like(MOST_OPAQUE, a)
    to_opacity = still = across = wide = none = like(0.0, a)
    first_column = np.uint64(begin)
    for k in range(np.uint64(end - begin)):
        dx, before = like(float(np.int32(k)), a) + start, befores[k]
        alpha = min(opacity * falloffs[k], most)
        rest = behind[row, first_column + k] - weights[k] * shown[k]
        behind[row, first_column + k] = rest
        by_alpha = before * shown[k] - rest / (one - alpha)
        # Where nothing is drawn, or no more than is possible, the opacity changes nothing.
        by_alpha = by_alpha if before > 0 and opacity * falloffs[k] < most else none
        to_opacity += by_alpha * falloffs[k]
        by_square = -alpha * by_alpha
        still += by_square
        across += by_square * dx
        wide += by_square * dx * dx
    return to_opacity, still, across, wide
