"""Orthonormal frames around an axis, in Blender's conventions for the named axes.

A frame is a (3, 3) float64 matrix with unit vectors as rows; the third row is the axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from pcore.errors import InputError

AXIS_NAMES = ("x", "y", "z")


def axis_vector(axis: str | Sequence[float]) -> Tensor:
    """Return the unit vector (3,) float64 of "x", "y", "z" or of any non-zero [x, y, z].

    Raises:
        InputError: an unknown name, a zero or non-finite vector, or not three numbers.
    """
    if isinstance(axis, str):
        if axis not in AXIS_NAMES:
            raise InputError(f'axis: expected "x", "y", "z" or [x, y, z], got {axis!r}')
        return _unit(AXIS_NAMES.index(axis))
    values = [float(value) for value in axis]
    largest = max((abs(value) for value in values), default=0.0)
    if len(values) != 3 or not math.isfinite(largest) or not all(map(math.isfinite, values)):
        raise InputError(f"axis: expected three finite numbers, got {values}")
    if largest == 0.0:
        raise InputError(
            "axis: expected a direction, got the zero vector; give any non-zero [x, y, z]"
        )
    # Divided by the largest component first so that tiny or huge vectors do not under- or overflow.
    vector = torch.tensor(values, dtype=torch.float64) / largest
    return vector / vector.norm()


def axis_frame(axis: str | Sequence[float]) -> Tensor:
    """Frame (3, 3) for twist, taper and stretch: rows (i, j, axis), right-handed.

    For the named axes i and j follow in cyclic order, as in Blender: x has (y, z). For any other
    direction the frame of the nearest named axis is tilted onto it.
    """
    direction = axis_vector(axis)
    first = _perpendicular(direction, (_dominant(direction) + 1) % 3)
    return torch.stack([first, torch.linalg.cross(direction, first), direction])


def bend_frame(axis: str | Sequence[float]) -> Tensor:
    """Frame (3, 3) for a bend: rows (driving direction, direction bent towards, axis).

    For the named axes as in Blender: x is driven by z and bends y, y is driven by z and bends x,
    z is driven by x and bends y; the frame of x is left-handed because Blender's bend about x
    turns the other way. For any other direction the frame of the nearest named axis is tilted
    onto it. Reversing the axis reverses the bend.
    """
    direction = axis_vector(axis)
    nearest = _dominant(direction)
    driving = _perpendicular(direction, 0 if nearest == 2 else 2)
    towards = torch.linalg.cross(direction, driving)
    return torch.stack([driving, -towards if nearest == 0 else towards, direction])


def perpendicular_frame(direction: Tensor, first: Tensor) -> Tensor:
    """Right-handed frame (3, 3) with axis `direction` (3,) and the part of `first` across it."""
    direction = direction / direction.norm()
    first = first - direction * (direction @ first)
    first = first / first.norm()
    return torch.stack([first, torch.linalg.cross(direction, first), direction])


def _dominant(direction: Tensor) -> int:
    return int(direction.abs().argmax())


def _perpendicular(direction: Tensor, index: int) -> Tensor:
    across = _unit(index) - direction * direction[index]
    return across / across.norm()


def _unit(index: int) -> Tensor:
    return torch.eye(3, dtype=torch.float64)[index]
