"""One flat Gaussian (2DGS) in one row of pixels, forward and backward, by numba."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from pcore.kernels.cpu_splats import FULL, HALF, MOST_OPAQUE, Discs, like


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
    """Draw a disc into a part of a row; return how many pixels it filled.

    Arguments are those of `cpu_gaussian_rows.draw_row`; a disc is drawn where the squared distance
    is at most its level.
    """
    opacity, color, shape = splats.opacities[g], splats.colors[g], _shape(splats, g)
    one, most, full = like(1.0, opacity), like(MOST_OPAQUE, opacity), like(FULL, opacity)
    half, dy = like(HALF, opacity), like(row + 0.5, opacity) - splats.means[g, 1]
    filled = 0
    for column in range(columns[0], columns[1]):
        before = left[row, column]
        if before < 0:
            continue
        dx = like(column + 0.5, opacity) - splats.means[g, 0]
        falloff, _, _, nearer = _met(shape, level, dx, dy)
        alpha = min(opacity * falloff, most)
        after = before * (one - alpha)
        if after <= full:
            left[row, column] = -before
            filled += 1
            continue
        weight = alpha * before
        for d in range(len(color)):
            planes[at, d, column] += weight * color[d]
        if splats.deep:
            planes[at, -1, column] += weight * color[-1] * (nearer - one)
        if weight > 0 and before > half:
            middle[row, column] = g
        left[row, column] = after
    return filled


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
    """Add the gradient of one disc in a part of a row to a row of `found` (2 + 6 + 1 + D).

    Arguments are those of `cpu_gaussian_rows.row_backward`, with a map for the conic.
    """
    opacity, color, shape = splats.opacities[g], splats.colors[g], _shape(splats, g)
    one, most, full = like(1.0, opacity), like(MOST_OPAQUE, opacity), like(FULL, opacity)
    to_opacity = to_nearer = none = like(0.0, opacity)
    total = none, none, none, none, none, none, none, none
    start, dy = found.shape[1] - len(color), like(row + 0.5, opacity) - splats.means[g, 1]
    for column in range(columns[0], columns[1]):
        before = left[at, column]
        if before < 0:
            continue
        dx = like(column + 0.5, opacity) - splats.means[g, 0]
        place = _met(shape, level, dx, dy)
        falloff, nearer = place[0], place[3]
        alpha = min(opacity * falloff, most)
        after = before * (one - alpha)
        if after <= full:
            left[at, column] = -before
            continue
        weight, seen = alpha * before, none
        for d in range(len(color)):
            found[slot, start + d] += weight * gradient[at, d, column]
            seen += gradient[at, d, column] * color[d]
        if splats.deep:
            to_nearer = gradient[at, -1, column] * color[-1]
            seen += to_nearer * (nearer - one)
            found[slot, -1] += weight * gradient[at, -1, column] * (nearer - one)
            to_nearer *= weight
        behind[row, column] -= weight * seen
        left[at, column] = after
        to_alpha = before * seen - behind[row, column] / (one - alpha)
        if opacity * falloff >= most:
            to_alpha = none
        to_opacity += to_alpha * falloff
        total = _added(shape, total, (dx, dy), place, -alpha * to_alpha, to_nearer)
    for k in range(len(total)):
        found[slot, k] += total[k]
    found[slot, start - 1] += to_opacity


@numba.njit(cache=True)
def _shape(splats: Discs, g: int) -> Any:
    """Six numbers of the map, and the precision."""
    one = splats.shapes[g]
    precision = like(splats.precision, one[0])
    return one[0], one[1], one[2], one[3], one[4], one[5], precision


@numba.njit(cache=True)
def _met(shape: Any, level: float, dx: Any, dy: Any) -> Any:
    """How a pixel meets a disc, s being the squared distance from its middle.

    Returns:
        exp(-s / 2); u and v where the ray meets it, NaN where it does not or where the round
        Gaussian is drawn; depth of the middle over that of the place, 1 where there is none.
    """
    px, py, qx, qy, wx, wy, precision = shape
    one, nowhere = like(1.0, dx), like(math.nan, dx)
    u, v, nearer, square = nowhere, nowhere, one, like(math.inf, dx)
    below = one + wx * dx + wy * dy
    if below > 0:  # Else the ray meets the plane behind the camera.
        nearer = one / below
        u, v = nearer * (px * dx + py * dy), nearer * (qx * dx + qy * dy)
        square = u * u + v * v
    around = precision * (dx * dx + dy * dy)
    if precision > 0 and around < square:
        square, u, nearer = around, nowhere, one
    if not square <= level:
        return like(0.0, dx), nowhere, nowhere, one
    return math.exp(like(-0.5, dx) * square), u, v, nearer


@numba.njit(cache=True)
def _added(shape: Any, total: Any, at: Any, place: Any, to_square: Any, to_nearer: Any) -> Any:
    """Sums of the gradients of mean and map with what a pixel adds.

    Args:
        shape: of `_shape`.
        total: sums up to now.
        at: dx, dy.
        place: of `_met`.
        to_square: derivative of the loss by s, twice.
        to_nearer: derivative by how much nearer the place is.
    """
    px, py, qx, qy, wx, wy, precision = shape
    (dx, dy), (_, u, v, nearer) = at, place
    x, y, ax, ay, bx, by, cx, cy = total
    if u != u:
        step = to_square * precision
        return x - step * dx, y - step * dy, ax, ay, bx, by, cx, cy
    to_u, to_v = to_square * u * nearer, to_square * v * nearer
    to_w = -(u * to_u + v * to_v) - to_nearer * nearer * nearer
    return (
        x - (px * to_u + qx * to_v + wx * to_w),
        y - (py * to_u + qy * to_v + wy * to_w),
        ax + to_u * dx,
        ay + to_u * dy,
        bx + to_v * dx,
        by + to_v * dy,
        cx + to_w * dx,
        cy + to_w * dy,
    )
