"""How a pixel meets a Gaussian or a flat one (2DGS), and what follows for gradients, by numba.

All that differs between the two is here. numba chooses by the type: a Gaussian is three numbers,
its conic; a disc is seven, its map (`disc_projection`) and the precision of the round Gaussian that
it never is smaller than, 0 for none.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
from numba.extending import overload


class Splats(NamedTuple):
    """The G Gaussians of all pictures, in pixels; arrays of float32 or float64, all the same.

    Attributes:
        means: (G, 2).
        shapes: (G, 3) conics.
        opacities: (G,).
        colors: (G, D).
    """

    means: np.ndarray
    shapes: np.ndarray
    opacities: np.ndarray
    colors: np.ndarray


class Discs(NamedTuple):
    """The G flat Gaussians of all pictures: as `Splats`, but for what is said here.

    Attributes:
        means: (G, 2).
        shapes: (G, 6) maps.
        opacities: (G,).
        colors: (G, D).
        precision: 1 / pixels squared.
        deep: whether the last colour is the depth of the middle; drawn is that of the pixel.
    """

    means: np.ndarray
    shapes: np.ndarray
    opacities: np.ndarray
    colors: np.ndarray
    precision: float
    deep: bool


def shape_of(splats: Any, g: int) -> Any:
    """The numbers of one of them, and whether its last colour is a depth."""
    raise NotImplementedError


def met(shape: Any, level: float, dx: Any, dy: Any) -> Any:
    """exp(-s / 2) at a pixel, s the squared distance; the place u, v; and how much nearer.

    Args:
        shape: of `shape_of`.
        level: a disc is drawn where s is at most this; Gaussians are drawn in their interval.
        dx: from the mean to the centre of the pixel, pixels.
        dy: the same.

    Returns:
        exp(-s / 2); of discs u and v where the ray meets them, NaN where it does not or where the
        round Gaussian is drawn; depth of the middle over that of the place, 1 where there is none.
    """
    raise NotImplementedError


def sums(shape: Any) -> Any:
    """Zeros to sum gradients of mean and shape in."""
    raise NotImplementedError


def added(shape: Any, total: Any, at: Any, place: Any, to_square: Any, to_nearer: Any) -> Any:
    """Sums with what a pixel adds.

    Args:
        shape: of `shape_of`.
        total: sums up to now.
        at: dx, dy.
        place: of `met`.
        to_square: derivative of the loss by s, twice.
        to_nearer: derivative by how much nearer the place is.
    """
    raise NotImplementedError


@numba.njit(cache=True)
def like(value: float, other: Any) -> Any:
    """A number of the type of another: float32 would become float64 beside a literal."""
    return type(other)(value)


@overload(shape_of)
def _shape_of(splats: Any, g: int) -> Any:
    def of_gaussian(splats: Any, g: int) -> Any:
        one = splats.shapes[g]
        return (one[0], one[1], one[2]), False

    def of_disc(splats: Any, g: int) -> Any:
        one = splats.shapes[g]
        precision = like(splats.precision, one[0])
        return (one[0], one[1], one[2], one[3], one[4], one[5], precision), splats.deep

    return of_disc if splats.instance_class is Discs else of_gaussian


@overload(met)
def _met(shape: Any, level: float, dx: Any, dy: Any) -> Any:
    def gaussian(shape: Any, level: float, dx: Any, dy: Any) -> Any:
        a, b, c = shape
        square = a * dx * dx + like(2.0, a) * b * dx * dy + c * dy * dy
        return math.exp(like(-0.5, a) * square), dx, dy, like(1.0, a)

    def disc(shape: Any, level: float, dx: Any, dy: Any) -> Any:
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

    return gaussian if len(shape) == 3 else disc


@overload(sums)
def _sums(shape: Any) -> Any:
    def gaussian(shape: Any) -> Any:
        none = like(0.0, shape[0])
        return none, none, none, none, none

    def disc(shape: Any) -> Any:
        none = like(0.0, shape[0])
        return none, none, none, none, none, none, none, none

    return gaussian if len(shape) == 3 else disc


@overload(added)
def _added(shape: Any, total: Any, at: Any, place: Any, to_square: Any, to_nearer: Any) -> Any:
    def gaussian(
        shape: Any, total: Any, at: Any, place: Any, to_square: Any, to_nearer: Any
    ) -> Any:
        (a, b, c), (dx, dy), (x, y, xx, xy, yy) = shape, at, total
        half = like(0.5, dx) * to_square
        return (
            x - to_square * (a * dx + b * dy),
            y - to_square * (b * dx + c * dy),
            xx + half * dx * dx,
            xy + to_square * dx * dy,
            yy + half * dy * dy,
        )

    def disc(shape: Any, total: Any, at: Any, place: Any, to_square: Any, to_nearer: Any) -> Any:
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

    return gaussian if len(shape) == 3 else disc
