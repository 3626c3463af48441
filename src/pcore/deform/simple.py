"""Blender's Simple Deform as maps of space, and the motions that go with it.

The formulas are those of Blender 4.5 with the extents frozen: Blender takes them from the vertices
it deforms, here they are numbers, so that a map means the same for every set of points.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from pcore.deform.base import (
    Deformation,
    apply_matrix,
    check_points,
    frozen_tensor,
    matrix_product,
)
from pcore.deform.motion import rigid, uniform_scale
from pcore.errors import InputError

__all__ = [
    "AlongAxis",
    "AxialStretch",
    "Bend",
    "SimpleDeform",
    "Stretch",
    "Taper",
    "Twist",
    "VolumeStretch",
    "rigid",
    "uniform_scale",
]

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


class _Turn(NamedTuple):
    """A turn and scaling of the cross-section as a complex number, and its slope along the axis."""

    real: Tensor
    imag: Tensor
    d_real: Tensor
    d_imag: Tensor


@dataclass(frozen=True, kw_only=True, eq=False)
class AlongAxis(SimpleDeform):
    """Deforms that act on each cross-section by its place t along the axis, the driving direction.

    The cross-section is multiplied by a complex number that depends on t, the axis grows by a
    constant factor; beyond the limits everything moves along with the cross-section at the limit.

    Attributes:
        lock: whether the first and the second cross direction of the frame keep their coordinate;
            as in Blender a locked coordinate counts as 0 for the other one.
    """

    lock: tuple[bool, bool] = (False, False)

    @property
    def growth(self) -> float:
        """Factor on the axis inside the limits."""
        return 1.0

    @abstractmethod
    def _turn(self, t: Tensor) -> _Turn:
        """Cross-section factor at places t along the axis."""

    def _map(self, local: Tensor) -> Tensor:
        x, y, z = local.unbind(dim=-1)
        t = z.clamp(*self.span)
        turn = self._turn(t)
        free_x, free_y = (float(not locked) for locked in self.lock)
        x_in, y_in = x * free_x, y * free_y
        return torch.stack(
            [
                turn.real * x_in - turn.imag * y_in + x * (1.0 - free_x),
                turn.imag * x_in + turn.real * y_in + y * (1.0 - free_y),
                t * self.growth + (z - t),
            ],
            dim=-1,
        )

    def _map_jacobian(self, local: Tensor) -> Tensor:
        x, y, z = local.unbind(dim=-1)
        a, b = self.span
        t = z.clamp(a, b)
        inside = ((z >= a) & (z <= b)).to(z)
        turn = self._turn(t)
        free_x, free_y = (float(not locked) for locked in self.lock)
        x_in, y_in = x * free_x, y * free_y
        zero = torch.zeros_like(z)
        return _matrices(
            (
                turn.real * free_x + (1.0 - free_x),
                -turn.imag * free_y,
                inside * (turn.d_real * x_in - turn.d_imag * y_in),
            ),
            (
                turn.imag * free_x,
                turn.real * free_y + (1.0 - free_y),
                inside * (turn.d_imag * x_in + turn.d_real * y_in),
            ),
            (zero, zero, inside * self.growth + (1.0 - inside)),
        )


class Twist(AlongAxis):
    """Turn cross-sections about the axis; `value` is the angle in radians over the limits."""

    def _turn(self, t: Tensor) -> _Turn:
        k = self.rate
        cos, sin = torch.cos(t * k), torch.sin(t * k)
        return _Turn(cos, sin, -k * sin, k * cos)


class Taper(AlongAxis):
    """Scale cross-sections by 1 + k t with k = value per unit length."""

    def _turn(self, t: Tensor) -> _Turn:
        zero = torch.zeros_like(t)
        return _Turn(1.0 + t * self.rate, zero, zero + self.rate, zero)


class Stretch(AlongAxis):
    """Blender's stretch: the axis times 1 + k, cross-sections times 1 - k + k t^2.

    k is `value` per unit length; the profile depends on the unit of length and flattens the middle
    when k reaches 1.
    """

    @property
    def growth(self) -> float:
        """Factor on the axis inside the limits."""
        return 1.0 + self.rate

    def _turn(self, t: Tensor) -> _Turn:
        k, zero = self.rate, torch.zeros_like(t)
        return _Turn(1.0 - k + k * t * t, zero, 2.0 * k * t, zero)


class AxialStretch(AlongAxis):
    """Make the part inside the limits 1 + value times as long and keep every cross-section."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.value <= -1.0:
            raise InputError(
                "stretch factor: expected more than -1 (the length becomes 1 + factor times), "
                f"got {self.value}"
            )

    @property
    def growth(self) -> float:
        """Factor on the axis inside the limits."""
        return 1.0 + self.value

    def _turn(self, t: Tensor) -> _Turn:
        zero = torch.zeros_like(t)
        return _Turn(zero + self._section(), zero, zero, zero)

    def _section(self) -> float:
        return 1.0


class VolumeStretch(AxialStretch):
    """The same, with cross-sections times 1 / sqrt(1 + value): volume is kept inside the limits."""

    def _section(self) -> float:
        return 1.0 / math.sqrt(1.0 + self.value)


class Bend(SimpleDeform):
    """Blender's bend: roll the driving direction up on a circle about the axis.

    `value` is the angle in radians over the limits; frame coordinates are (driving, towards, axis).
    With theta = t k and cut the part beyond the limits, Blender's formula with r = 1 / k is
    towards' = r - (r - towards) cos(theta) + sin(theta) cut and
    driving' = (r - towards) sin(theta) + cos(theta) cut. Here r (1 - cos) and r sin are
    written with sinc, which is exact and smooth down to a bend of zero.
    """

    def _map(self, local: Tensor) -> Tensor:
        driving, towards, axis = local.unbind(dim=-1)
        t = driving.clamp(*self.span)
        cut = driving - t
        theta = t * self.rate
        cos, sin = torch.cos(theta), torch.sin(theta)
        half = 0.5 * theta
        rise = t * torch.sin(half) * torch.sinc(half / math.pi)
        run = t * torch.sinc(theta / math.pi)
        return torch.stack(
            [run - towards * sin + cos * cut, rise + towards * cos + sin * cut, axis], dim=-1
        )

    def _map_jacobian(self, local: Tensor) -> Tensor:
        driving, towards, _ = local.unbind(dim=-1)
        a, b = self.span
        theta = driving.clamp(a, b) * self.rate
        cos, sin = torch.cos(theta), torch.sin(theta)
        inside = ((driving >= a) & (driving <= b)).to(driving)
        # Inside, lengths along the circle shrink towards its centre; outside nothing does.
        along = 1.0 - inside * self.rate * towards
        zero, one = torch.zeros_like(cos), torch.ones_like(cos)
        return _matrices((cos * along, -sin, zero), (sin * along, cos, zero), (zero, zero, one))


def _finite(pair: tuple[float, float]) -> bool:
    return math.isfinite(pair[0]) and math.isfinite(pair[1])


def _matrices(*rows: tuple[Tensor, Tensor, Tensor]) -> Tensor:
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)
