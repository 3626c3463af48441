"""What an entry of an edit file is, and the entries that need nothing but numbers.

The `description` of a field completes the sentence "expected ..." in error messages, so that the
rule and its message stand together.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Annotated, ClassVar, Literal, NamedTuple

import torch
from pydantic import BaseModel, ConfigDict, Field, model_validator
from torch import Tensor

from pcore.deform.base import Deformation, apply_matrix
from pcore.deform.frame import AXIS_NAMES, axis_frame, bend_frame
from pcore.deform.simple import (
    AlongAxis,
    AxialStretch,
    Bend,
    Stretch,
    Taper,
    Twist,
    VolumeStretch,
    rigid,
    uniform_scale,
)
from pcore.editing.fields import (
    AXIS,
    EXTENT,
    ROTATION,
    Angle,
    Axis,
    Extent,
    Factor,
    Limits,
    Positive,
    Rotation,
    Triple,
    check_turn,
    turn_of,
)
from pcore.editing.regions import REGION, AnyRegion, Setting
from pcore.errors import EditError


class _Placement(NamedTuple):
    """The arguments that every simple deform takes besides its value."""

    rotation: Tensor
    origin: Tensor
    extent: tuple[float, float]
    limits: tuple[float, float]


class Edit(BaseModel, ABC):
    """One entry of an edit file; world units.

    Attributes:
        region: where it acts, with a seam; None is everywhere.
        freeze: where it does not act, whatever `region` says.
        name: what people call it; it does nothing.
        enabled: false keeps it in the list and leaves it out.
        advice: what to do when it folds space.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    advice: ClassVar[str] = "lower its amount"

    region: Annotated[AnyRegion | None, Field(description=REGION)] = None
    freeze: Annotated[tuple[AnyRegion, ...], Field(description=f"a list, each {REGION}")] = ()
    name: Annotated[
        str | None, Field(strict=True, min_length=1, max_length=200, description="a text, not long")
    ] = None
    enabled: Annotated[bool, Field(strict=True, description="true or false")] = True

    @abstractmethod
    def bind(self, points: Tensor) -> Deformation:
        """Deformation of this edit in all of space, frozen to points (N, 3) float64 as they arrive.

        Raises:
            EditError: the points do not fit the edit, such as no extent to freeze.
            InputError: an amount that no map can have, or a file that cannot be read.
        """

    def place(self, setting: Setting) -> Deformation:
        """Do the same where an edit needs to know more than the points; without its region."""
        return self.bind(setting.points)

    def notes(self, setting: Setting, step: Deformation) -> tuple[str, ...]:
        """Say what is odd about the edit at these points, though it can be meant.

        Args:
            setting: what it is bound to.
            step: what it is bound as, with its region.

        Raises:
            EditError: it cannot be meant.
        """
        del setting, step
        return ()


class PlacedEdit(Edit):
    """What all edits share that are made about a point."""

    origin: Annotated[Triple, Field(description="three finite numbers [x, y, z]")] = (0.0, 0.0, 0.0)


class SimpleEdit(PlacedEdit):
    """What twist, bend, taper and stretch share."""

    advice: ClassVar[str] = (
        "lower the angle or factor, widen the limits or the extent, or move the origin"
    )

    axis: Annotated[Axis, Field(description=AXIS)]
    limits: Limits = (0.0, 1.0)
    lock: Annotated[
        tuple[Literal["x", "y", "z"], ...], Field(description='a list of "x", "y", "z"')
    ] = ()
    extent: Extent | None = Field(default=None, description=EXTENT)

    @model_validator(mode="after")
    def _lock_needs_name(self) -> SimpleEdit:
        if self.lock and not isinstance(self.axis, str):
            raise ValueError(
                f'"lock" needs an axis that is "x", "y" or "z", got the axis {list(self.axis)}; '
                "a tilted deformation has no x, y, z of its own to lock"
            )
        return self

    def _placement(self, points: Tensor, rotation: Tensor, driving: int) -> _Placement:
        """Place the frame at the origin and freeze the extent along its driving vector."""
        origin = torch.tensor(self.origin, dtype=torch.float64)
        extent = self.extent
        if extent is None:
            extent = _measure(points - origin, rotation[driving])
        return _Placement(rotation, origin, extent, self.limits)

    def _along_axis(self, kind: type[AlongAxis], value: float, points: Tensor) -> AlongAxis:
        rotation = axis_frame(self.axis)
        lock = (False, False)
        if isinstance(self.axis, str):
            index = AXIS_NAMES.index(self.axis)
            first, second = AXIS_NAMES[(index + 1) % 3], AXIS_NAMES[(index + 2) % 3]
            lock = (first in self.lock, second in self.lock)
        placement = self._placement(points, rotation, driving=2)
        return kind(**placement._asdict(), value=value, lock=lock)


class TwistEdit(SimpleEdit):
    """Turn cross-sections about the axis, `angle_deg` in all."""

    type: Literal["twist"] = "twist"
    angle_deg: Angle

    def bind(self, points: Tensor) -> Deformation:
        """See `Edit.bind`."""
        return self._along_axis(Twist, math.radians(self.angle_deg), points)


class BendEdit(SimpleEdit):
    """Bend about the axis, `angle_deg` in all; `lock` is read and, as in Blender, ignored."""

    type: Literal["bend"] = "bend"
    angle_deg: Angle

    def bind(self, points: Tensor) -> Deformation:
        """See `Edit.bind`."""
        placement = self._placement(points, bend_frame(self.axis), driving=0)
        return Bend(**placement._asdict(), value=math.radians(self.angle_deg))


class TaperEdit(SimpleEdit):
    """Scale cross-sections linearly along the axis."""

    type: Literal["taper"] = "taper"
    factor: Factor

    def bind(self, points: Tensor) -> Deformation:
        """See `Edit.bind`."""
        return self._along_axis(Taper, self.factor, points)


_STRETCHES: dict[str, type[AlongAxis]] = {
    "blender": Stretch,
    "axial": AxialStretch,
    "volume": VolumeStretch,
}


class StretchEdit(SimpleEdit):
    """Lengthen along the axis with one of three profiles of the cross-section."""

    advice: ClassVar[str] = (
        'lower the factor, widen the limits or the extent, or use the profile "axial" or "volume"'
    )

    type: Literal["stretch"] = "stretch"
    factor: Factor
    profile: Annotated[
        Literal["blender", "axial", "volume"],
        Field(description='"blender", "axial" or "volume"'),
    ] = "blender"

    @model_validator(mode="after")
    def _length_stays_positive(self) -> StretchEdit:
        if self.profile != "blender" and self.factor <= -1.0:
            raise ValueError(
                f'"factor": expected more than -1 with the profile "{self.profile}" (the length '
                f"becomes 1 + factor times, so less is a singular deformation), got {self.factor}"
            )
        return self

    def bind(self, points: Tensor) -> Deformation:
        """See `Edit.bind`."""
        return self._along_axis(_STRETCHES[self.profile], self.factor, points)


class ScaleEdit(PlacedEdit):
    """Multiply distances from the origin by `factor`."""

    type: Literal["scale"] = "scale"
    factor: Positive

    def bind(self, points: Tensor) -> Deformation:
        """See `Edit.bind`."""
        return uniform_scale(self.factor, self.origin)


class RigidEdit(PlacedEdit):
    """Turn by `angle_deg` about the axis through the origin, or by `rotation`, then translate."""

    type: Literal["rigid"] = "rigid"
    axis: Axis | None = Field(default=None, description=AXIS)
    angle_deg: Angle = 0.0
    rotation: Annotated[Rotation | None, Field(description=ROTATION)] = None
    translation: Annotated[Triple, Field(description="three finite numbers [x, y, z]")] = (
        0.0,
        0.0,
        0.0,
    )

    @model_validator(mode="after")
    def _turn_needs_axis(self) -> RigidEdit:
        check_turn(self.axis, self.angle_deg, self.rotation)
        return self

    def bind(self, points: Tensor) -> Deformation:
        """See `Edit.bind`."""
        turn = turn_of(self.axis, self.angle_deg, self.rotation)
        return rigid(*turn, self.translation, self.origin)


def _measure(points: Tensor, direction: Tensor) -> tuple[float, float]:
    """Least and greatest coordinate of points (N, 3) along a direction (3,)."""
    if len(points) == 0:
        raise EditError(
            'expected at least one point to take the extent from, got none; give "extent": [lo, hi]'
        )
    along = apply_matrix(direction.expand(1, 3), points)
    lo, hi = (float(value) for value in torch.aminmax(along))
    if not lo < hi:
        raise EditError(
            "expected points that extend along the driving direction of this edit, got all "
            f'{len(points)} at {lo:g}; give "extent": [lo, hi] or another axis'
        )
    return lo, hi
