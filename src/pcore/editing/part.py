"""The edit that moves one part of an object: a similarity transform in a region."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import torch
from pydantic import Field, model_validator
from torch import Tensor

from pcore.deform.base import Affine, Compose, Deformation
from pcore.deform.simple import rigid, uniform_scale
from pcore.editing.edits import Edit
from pcore.editing.fields import (
    AXIS,
    ROTATION,
    Angle,
    Axis,
    Positive,
    Rotation,
    Triple,
    check_turn,
    turn_of,
)
from pcore.editing.regions import REGION, AnyRegion, Setting, bind_region

_TRIPLE = "three finite numbers [x, y, z]"


class PartEdit(Edit):
    """Scale the part by `factor`, turn it about `origin` (angle or `rotation`), translate it."""

    advice: ClassVar[str] = "move, turn or scale the part less"

    type: Literal["part"] = "part"
    region: Annotated[AnyRegion, Field(description=REGION)]  # pyright: ignore
    axis: Axis | None = Field(default=None, description=AXIS)
    angle_deg: Angle = 0.0
    rotation: Annotated[Rotation | None, Field(description=ROTATION)] = None
    factor: Positive = 1.0
    translation: Annotated[Triple, Field(description=_TRIPLE)] = (0.0, 0.0, 0.0)
    origin: Annotated[Triple | None, Field(description=_TRIPLE)] = None

    @model_validator(mode="after")
    def _turn_needs_axis(self) -> PartEdit:
        check_turn(self.axis, self.angle_deg, self.rotation)
        return self

    def bind(self, points: Tensor) -> Deformation:
        """See `Edit.bind`."""
        return self.place(Setting(points=points, rest=points))

    def place(self, setting: Setting) -> Deformation:
        """See `Edit.place`."""
        origin = self.pivot(setting)
        turn_by = turn_of(self.axis, self.angle_deg, self.rotation)
        turn = rigid(*turn_by, self.translation, origin)
        if self.factor == 1.0:
            return turn
        return _merged(uniform_scale(self.factor, origin), turn)

    def pivot(self, setting: Setting) -> Tensor:
        """`origin` (3,) float64; where none is given, the centre of the points in the region."""
        if self.origin is not None:
            return torch.tensor(self.origin, dtype=torch.float64)
        weight = bind_region(self.region, setting).weight(setting.points).unsqueeze(-1)
        return (weight * setting.points).sum(dim=0) / weight.sum()


def _merged(first: Affine, second: Affine) -> Affine:
    both = Compose(first, second)
    zero = torch.zeros(3, dtype=torch.float64)
    return Affine(both.jacobian(zero), both(zero))
