"""The edit "anchors": handles on a cloud's anchors that are dragged and turned."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import torch
from pydantic import BaseModel, ConfigDict, Field, model_validator
from torch import Tensor

from pcore.deform.base import Deformation, Identity
from pcore.deform.motion import rigid
from pcore.editing.anchors import AnchorRig, rig_of
from pcore.editing.arap import Dragger, Handle
from pcore.editing.edits import PlacedEdit
from pcore.editing.fields import (
    AXIS,
    ROTATION,
    Amount,
    Angle,
    Axis,
    Number,
    Rotation,
    Triple,
    turn_of,
)
from pcore.editing.regions import NEAR, Setting
from pcore.errors import EditError
from pcore.geometry.farthest_points import ANCHORS

_REACH = 0.25
_TRIPLE = "three finite numbers [x, y, z]"


class HandleEdit(BaseModel):
    """One handle: which anchor, where it goes, how it turns.

    A handle given by `near` shifts the point nearest to that place by `to - near`, so that the
    file means the same on a cloud whose points lie elsewhere. With learned weights, whose anchors
    are what they are, it is the nearest anchor.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    anchor: Annotated[
        int | None, Field(strict=True, ge=0, description="the number of an anchor, from 0")
    ] = None
    near: Annotated[Triple | None, Field(description=_TRIPLE)] = None
    to: Annotated[Triple, Field(description=_TRIPLE)]
    axis: Annotated[Axis | None, Field(description=AXIS)] = None
    angle_deg: Angle = 0.0
    rotation: Annotated[Rotation | None, Field(description=ROTATION)] = None

    @model_validator(mode="after")
    def _one_way_to_say_which(self) -> HandleEdit:
        if (self.anchor is None) == (self.near is None):
            got = "neither" if self.anchor is None else "both"
            raise ValueError(
                'expected either "anchor" (its number) or "near" (a place [x, y, z]) to say which '
                f"anchor is meant, got {got}"
            )
        if self.rotation is not None and (self.axis is not None or self.angle_deg != 0.0):
            raise ValueError('expected either a "rotation" or an "axis" with an angle, got both')
        if self.rotation is None and self.axis is None and self.angle_deg != 0.0:
            raise ValueError('a handle with "angle_deg" needs an "axis" to turn about, got none')
        return self

    def turned(self, amount: float) -> Tensor | None:
        """(3, 3) so much of the turn that it carries; None when it gives none."""
        if self.axis is None and self.rotation is None:
            return None
        if self.rotation is None:
            return rigid(*turn_of(self.axis, amount * self.angle_deg, None)).matrix
        axis, angle = turn_of(None, 0.0, self.rotation)
        return rigid(axis, amount * angle).matrix


class AnchorsEdit(PlacedEdit):
    """Drag anchors; the others follow as rigidly as they can, those out of reach stay.

    `near` and `to` are measured from `origin`. `amount` is the share of its way, and of its turn,
    that every handle goes: half a drag is a drag half as far, not a blend of two shapes.
    """

    advice: ClassVar[str] = "drag the handles less far, or turn them along"

    type: Literal["anchors"] = "anchors"
    handles: Annotated[
        tuple[HandleEdit, ...],
        Field(
            min_length=1,
            description='a list of handles {"anchor": number or "near": [x, y, z], '
            '"to": [x, y, z]} with an optional "axis" and "angle_deg", or "rotation"',
        ),
    ]
    reach: Annotated[
        Number | None,
        Field(gt=0, description="a number above 0: path length along the object, world units"),
    ] = None
    amount: Amount = 1.0
    count: Annotated[
        int, Field(strict=True, ge=2, description="a whole number of anchors, at least 2")
    ] = ANCHORS
    seed: Annotated[int, Field(strict=True, ge=0, description="a whole number, 0 or more")] = 0

    def bind(self, points: Tensor) -> Deformation:
        """See `Edit.bind`; weights are those by path length."""
        return self.place(Setting(points=points, rest=points))

    def place(self, setting: Setting) -> Deformation:
        """See `Edit.place`; weights are those of the run, where they are of the same anchors.

        Raises:
            EditError: also where the run's weights are of other points.
        """
        return self.bind_to(self.rig(setting))

    def rig(self, setting: Setting) -> AnchorRig:
        """Return the points as they arrive at this edit, with its anchors; errors as `place`."""
        rig = setting.rig
        if rig is None or not rig.is_of(count=self.count, seed=self.seed):
            # Anchors of the rest state: what earlier edits do, in any frame, chooses no others.
            own = self._nearest_points(setting.points)
            rest = rig_of(setting.rest, count=self.count, seed=self.seed, also=own)
            return rest.at(setting.points)
        if not torch.equal(rig.points, setting.rest.to(rig.points.dtype)):
            raise EditError(
                f"learned skinning: expected the {len(rig.points)} points that its weights belong "
                f"to, got {len(setting.rest)} others; give the points of the same run"
            )
        return rig.at(setting.points)

    def _nearest_points(self, points: Tensor) -> tuple[int, ...]:
        """Indices of the points (N, 3) nearest to the handles; anchors of the seed make room.

        A handle then holds the very place it names. None where handles go by numbers, which are
        those of the anchors of the seed.
        """
        origin = torch.tensor(self.origin)
        places = [origin + torch.tensor(h.near) for h in self.handles if h.near is not None]
        if len(places) < len(self.handles) or len(places) > self.count:
            return ()
        # Every drag asks, for few handles: a search tree of all points would cost more.
        rows = [int((points - place).square().sum(dim=1).argmin()) for place in places]
        return tuple(dict.fromkeys(rows))

    def bind_to(self, rig: AnchorRig) -> Deformation:
        """Pose a rig that is known already, such as one with learned weights.

        Raises:
            EditError: an unknown anchor, a place far from the object, or two handles on one anchor.
        """
        dragger, handles = self.dragger(rig)
        # Handles that go nowhere leave the rest where it is to rounding only.
        return rig.deformation(dragger.pose(handles)) if self.amount else Identity()

    def dragger(self, rig: AnchorRig) -> tuple[Dragger, dict[int, Handle]]:
        """Return what poses the anchors, and its handles; errors as `bind_to`."""
        handles = self.placed(rig)
        reach = self.reach_of(self.reach, rig.size)
        return Dragger(rig.graph, tuple(handles), reach=reach), handles

    @staticmethod
    def reach_of(reach: float | None, size: float) -> float:
        """How far along the surface handles reach, on an object of a size; None is the usual."""
        return _REACH * size if reach is None else reach

    def placed(self, rig: AnchorRig) -> dict[int, Handle]:
        """Return the handles by anchor index, in world units; errors as `bind_to`."""
        rest, origin = rig.graph.rest, torch.tensor(self.origin)
        found: dict[int, Handle] = {}
        for number, handle in enumerate(self.handles, start=1):
            target = origin + torch.tensor(handle.to)
            if handle.near is None:
                index = -1 if handle.anchor is None else handle.anchor
                _check_known(number, index, len(rest))
            else:
                near = origin + torch.tensor(handle.near)
                index = _nearest_anchor(number, near, rig)
                target = rest[index] + (target - near)
            if index in found:
                raise EditError(
                    f"handle {number}: expected every handle on an anchor of its own, got anchor "
                    f"{index} twice; move the handles apart or ask for more anchors"
                )
            way = self.amount * (target - rest[index])
            place = target if self.amount == 1.0 else rest[index] + way
            found[index] = Handle(place=place, rotation=handle.turned(self.amount))
        return found


def _check_known(number: int, index: int, count: int) -> None:
    if not 0 <= index < count:
        raise EditError(
            f"handle {number}: expected an anchor from 0 to {count - 1}, got {index}; "
            'after retraining name it by its place: "near": [x, y, z]'
        )


def _nearest_anchor(number: int, near: Tensor, rig: AnchorRig) -> int:
    """Index of the anchor nearest to a place (3,), which must lie on or beside the object."""
    distance = (rig.graph.rest - near).norm(dim=1)
    index = int(distance.argmin())
    if float(distance[index]) > NEAR * rig.size:
        place = ", ".join(f"{x:.4g}" for x in near.tolist())
        raise EditError(
            f"handle {number}: expected a place on the object, got [{place}], which is "
            f"{float(distance[index]):.3g} from the nearest anchor (object size {rig.size:.3g}); "
            "is it in world units?"
        )
    return index
