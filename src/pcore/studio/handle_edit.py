"""Handles of an edit by anchors: where they are on the object, and where a drag puts them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from pcore.deform.frame import axis_vector
from pcore.editing.state import EditState

Quat = tuple[float, float, float, float]
STILL: Quat = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class HandlePose:
    """Where a handle is and how it is turned.

    Attributes:
        place: (3,) world units.
        turn: unit quaternion w, x, y, z.
    """

    place: tuple[float, float, float]
    turn: Quat = STILL


def arriving(state: EditState, index: int) -> Tensor:
    """Points (N, 3) float64 as they arrive at an edit; those of one too many are the last ones."""
    bound = state.bound
    while len(bound.steps) > index and bound.before is not None:
        bound = bound.before
    return bound.setting.points


def handle_points(raw: dict[str, Any], points: Tensor) -> list[int | None]:
    """Numbers of the points that handles are on; None of those given by the number of an anchor.

    Args:
        raw: the edit.
        points: (N, 3) as they arrive at it.
    """
    origin = _triple(raw.get("origin"))
    return [
        None
        if one.get("near") is None
        else int((points - origin - _triple(one["near"])).square().sum(dim=1).argmin())
        for one in raw["handles"]
    ]


def placed(raw: dict[str, Any], state: EditState, index: int) -> list[HandlePose]:
    """Where the handles of an edit are now.

    Args:
        raw: the edit, without keyframes.
        state: the object.
        index: of the edit.
    """
    points, origin = arriving(state, index), _triple(raw.get("origin"))
    last = index + 1 == len(state.bound.steps)
    poses: list[HandlePose] = []
    for one, point in zip(raw["handles"], handle_points(raw, points), strict=True):
        place = origin + _triple(one["to"])
        if point is not None:
            near = origin + _triple(one["near"])
            place = near + raw.get("amount", 1.0) * (place - near)
            # What later edits do to the place is what they do to the point there.
            place = place if last else state.bound.setting.points[point]
        x, y, z = place.tolist()
        poses.append(HandlePose(place=(x, y, z), turn=_turn(one)))
    return poses


def moved_handle(
    raw: dict[str, Any], number: int, before: HandlePose, after: HandlePose
) -> dict[str, Any]:
    """Return an edit with one handle moved and turned.

    Args:
        raw: the edit, without keyframes.
        number: of the handle.
        before: where it is shown.
        after: where it is to be.
    """
    one = dict(raw["handles"][number])
    share = max(float(raw.get("amount", 1.0)), 1e-3)
    way = (_triple(after.place) - _triple(before.place)) / share
    one["to"] = (_triple(one["to"]) + way).tolist()
    if after.turn != before.turn:
        one |= _axis_angle(after.turn)
    handles = [one if k == number else other for k, other in enumerate(raw["handles"])]
    return {**raw, "handles": handles}


def _triple(values: Any) -> Tensor:
    return torch.tensor([0.0] * 3 if values is None else list(values), dtype=torch.float64)


def _turn(one: dict[str, Any]) -> Quat:
    if one.get("axis") is None:
        return STILL
    half = math.radians(one.get("angle_deg", 0.0)) / 2
    x, y, z = (axis_vector(one["axis"]).double() * math.sin(half)).tolist()
    return math.cos(half), x, y, z


def _axis_angle(turn: Quat) -> dict[str, Any]:
    w, *vector = turn
    along = torch.tensor(vector, dtype=torch.float64)
    length = float(along.norm())
    if length < 1e-9:
        return {"axis": "z", "angle_deg": 0.0}
    angle = math.degrees(2 * math.atan2(length, w))
    angle = angle - 360 if angle > 180 else angle
    return {"axis": (along / length).tolist(), "angle_deg": angle}
