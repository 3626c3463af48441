"""Maps that keep shapes: uniform scaling and rigid motion."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from pcore.deform.base import Affine
from pcore.deform.frame import axis_vector
from pcore.errors import InputError


def uniform_scale(factor: float, origin: Sequence[float] | Tensor = (0.0, 0.0, 0.0)) -> Affine:
    """Multiply distances from the origin (3,) by a positive factor.

    Raises:
        InputError: the factor is not positive and finite (0 is singular, less is a mirror).
    """
    if not (math.isfinite(factor) and factor > 0):
        raise InputError(f"scale factor: expected a positive finite number, got {factor}")
    center = torch.as_tensor(origin, dtype=torch.float64)
    return Affine(factor * torch.eye(3, dtype=torch.float64), (1.0 - factor) * center)


def rigid(
    axis: str | Sequence[float] = "z",
    angle: float = 0.0,
    translation: Sequence[float] | Tensor = (0.0, 0.0, 0.0),
    origin: Sequence[float] | Tensor = (0.0, 0.0, 0.0),
) -> Affine:
    """Turn by `angle` radians (right-handed) about the axis through the origin, then translate.

    Raises:
        InputError: a zero axis or numbers that are not finite.
    """
    x, y, z = axis_vector(axis).tolist()
    cross = torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.float64)
    eye = torch.eye(3, dtype=torch.float64)
    # Rodrigues' formula.
    rotation = eye + math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross)
    center = torch.as_tensor(origin, dtype=torch.float64)
    shift = torch.as_tensor(translation, dtype=torch.float64)
    return Affine(rotation, center - rotation @ center + shift)
