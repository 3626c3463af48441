"""What is blended on the CPU: Gaussians in pixels, or flat ones (2DGS) as maps of discs."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np


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
        precision: of the round Gaussian that none is smaller than, 1 / pixels squared; 0 for none.
        deep: whether the last colour is the depth of the middle; drawn is that of the pixel.
    """

    means: np.ndarray
    shapes: np.ndarray
    opacities: np.ndarray
    colors: np.ndarray
    precision: float
    deep: bool


MOST_OPAQUE = 0.999
"""Greatest opacity of a Gaussian in a pixel."""
FULL = 1e-4
"""A pixel is full before its transmittance falls to this."""
HALF = 0.5
"""Transmittance up to which what a pixel shows lies in front of its median."""


@numba.njit(cache=True)
def like(value: float, other: Any) -> Any:
    """A number of the type of another: float32 would become float64 beside a literal."""
    return type(other)(value)
