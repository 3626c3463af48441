"""What was up for a photographer. Numpy alone, since the child that runs COLMAP uses it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_AROUND, _SHAKE = 0.005, 4.0
"""Mean square of the cameras' rights in their second direction, from which on they span a plane:
some 15 degrees of a circle, and as many times what hands shake out of it."""
_CANCELLED = 1e-3
"""Shorter mean axes say nothing: the cameras look at the object any way up."""
_STRAIGHT = 0.1
"""Of cameras that look down so steeply (6 degrees) hands decide where the tops of pictures lean."""


def upward(right: Floats, top: Floats) -> Floats:
    """(3,) up, of unit length: across what is right in all pictures, on the side of their tops.

    A camera that looks down has an upward axis that leans; its right stays level. Where all look
    straight down, up is on the side that they look from. Where all look the same way round, their
    rights span no plane, and the mean of the upward axes has to do.

    Args:
        right: (N, 3) right axes of the cameras, N at least 1, of unit length.
        top: (N, 3) their upward axes.
    """
    mean: Floats = top.mean(axis=0)
    shares, axes = np.linalg.eigh(right.T @ right / len(right))
    if shares[1] >= max(_AROUND, _SHAKE * shares[0]):
        across: Floats = axes[:, 0]
        along = float(mean @ across)
        if abs(along) < _STRAIGHT:
            along = float(np.cross(right, top).mean(axis=0) @ across)
        if abs(along) >= _CANCELLED:
            return across * np.sign(along)
    length = float(np.linalg.norm(mean))
    return mean / length if length >= _CANCELLED else top[0]
