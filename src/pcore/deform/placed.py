"""What the simple deforms share: where they stand in space and how far they reach."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.deform.base import (
    Deformation,
    apply_matrix,
    check_points,
    frozen_tensor,
    matrix_product,
)
from pcore.errors import InputError

_ORTHONORMAL_TOLERANCE = 1e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class SimpleDeform(Deformation):
    """What all simple deforms share: a frame, an extent along the driving direction, an amount.

    Attributes:
        rotation: (3, 3) orthonormal, frame vectors as rows (see `pcore.deform.frame`).
        origin: (3,) world units; coordinates in the frame are measured from here.
        extent: (lo, hi) of the driving coordinate in the frame, world units.
        value: the amount: radians for twist and bend, the factor for the others.
        limits: the part of the extent, as fractions (0, 1), that is deformed.
    """

    rotation: Tensor
    origin: Tensor
    extent: tuple[float, float]
    value: float
    limits: tuple[float, float] = (0.0, 1.0)

    def __post_init__(self) -> None:
        rotation = frozen_tensor("deform frame", self.rotation, (3, 3))
        error = (rotation @ rotation.T - torch.eye(3, dtype=torch.float64)).abs().max().item()
        if error > _ORTHONORMAL_TOLERANCE:
            raise InputError(
                f"deform frame: expected orthonormal rows, got a matrix that is off by {error:.2g}"
            )
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "origin", frozen_tensor("deform origin", self.origin, (3,)))
        if not (_finite(self.extent) and self.extent[0] < self.extent[1]):
            raise InputError(f"deform extent: expected finite lo < hi, got {self.extent}")
        if not (_finite(self.limits) and 0.0 <= self.limits[0] < self.limits[1] <= 1.0):
            raise InputError(f"deform limits: expected 0 <= first < second <= 1, got {self.limits}")
        if not math.isfinite(self.value):
            raise InputError(f"deform value: expected a finite number, got {self.value}")
        a, b = self.span
        if not (a < b and math.isfinite(self.value / (b - a))):
            raise InputError(
                f"deform limits: expected a span that numbers can resolve, got {a} to {b} for "
                f"the value {self.value}; widen the extent or the limits"
            )

    @property
    def span(self) -> tuple[float, float]:
        """Driving coordinates (a, b) between which the deformation acts, world units."""
        lo, hi = self.extent
        return lo + (hi - lo) * self.limits[0], lo + (hi - lo) * self.limits[1]

    @property
    def rate(self) -> float:
        """The amount per unit of length along the driving direction."""
        a, b = self.span
        return self.value / (b - a)

    def __call__(self, points: Tensor) -> Tensor:
        """Map points (..., 3), world units."""
        rotation, origin = self.rotation.to(points), self.origin.to(points)
        moved = self._map(self._local(points))
        return apply_matrix(rotation.T, moved) + origin

    def jacobian(self, points: Tensor) -> Tensor:
        """Jacobians (..., 3, 3) at points (..., 3), by formula."""
        rotation = self.rotation.to(points)
        inside = self._map_jacobian(self._local(points))
        return matrix_product(rotation.T, matrix_product(inside, rotation))

    def _local(self, points: Tensor) -> Tensor:
        check_points(points)
        return apply_matrix(self.rotation.to(points), points - self.origin.to(points))

    @abstractmethod
    def _map(self, local: Tensor) -> Tensor:
        """Map frame coordinates (..., 3)."""

    @abstractmethod
    def _map_jacobian(self, local: Tensor) -> Tensor:
        """Jacobians (..., 3, 3) of `_map`."""


def _finite(pair: tuple[float, float]) -> bool:
    return math.isfinite(pair[0]) and math.isfinite(pair[1])
