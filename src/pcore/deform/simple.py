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

from pcore.deform.motion import rigid, uniform_scale
from pcore.deform.placed import SimpleDeform
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


class SectionScale(AlongAxis):
    """Deforms that scale cross-sections, without turning them."""

    @abstractmethod
    def _section(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """Factor on the cross-section at places t along the axis, and its slope."""

    def _turn(self, t: Tensor) -> _Turn:
        factor, slope = self._section(t)
        zero = torch.zeros_like(t)
        return _Turn(factor, zero, slope, zero)

    def folded(self, points: Tensor) -> Tensor:
        """Where space is flattened or turned inside out, bool (...,).

        A negative factor on both cross directions leaves det J positive, but the cloud has
        been pulled through the axis on the way there.
        """
        with torch.no_grad():
            factor, _ = self._section(self._local(points)[..., 2].clamp(*self.span))
        return super().folded(points) | ~(factor > 0)


class Taper(SectionScale):
    """Scale cross-sections by 1 + k t with k = value per unit length."""

    def _section(self, t: Tensor) -> tuple[Tensor, Tensor]:
        return 1.0 + t * self.rate, torch.ones_like(t) * self.rate


class Stretch(SectionScale):
    """Blender's stretch: the axis times 1 + k, cross-sections times 1 - k + k t^2.

    k is `value` per unit length; the profile depends on the unit of length and flattens the middle
    when k reaches 1.
    """

    @property
    def growth(self) -> float:
        """Factor on the axis inside the limits."""
        return 1.0 + self.rate

    def _section(self, t: Tensor) -> tuple[Tensor, Tensor]:
        k = self.rate
        return 1.0 - k + k * t * t, 2.0 * k * t


class AxialStretch(SectionScale):
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

    def _section(self, t: Tensor) -> tuple[Tensor, Tensor]:
        return torch.ones_like(t), torch.zeros_like(t)


class VolumeStretch(AxialStretch):
    """The same, with cross-sections times 1 / sqrt(1 + value): volume is kept inside the limits."""

    def _section(self, t: Tensor) -> tuple[Tensor, Tensor]:
        return torch.full_like(t, 1.0 / math.sqrt(self.growth)), torch.zeros_like(t)


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


def _matrices(*rows: tuple[Tensor, Tensor, Tensor]) -> Tensor:
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)
