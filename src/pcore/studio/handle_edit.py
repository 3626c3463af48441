"""Handles of an edit by anchors: where they are on the object, and where a drag puts them."""

from __future__ import annotations

import math
from typing import Any

from torch import Tensor

from pcore.editing.dragging import Mirror
from pcore.editing.regions import Setting
from pcore.editing.state import EditState
from pcore.studio.handle_pose import STILL, HandlePose, Quat, is_turned, triple, turn_about, way_of


def arriving(state: EditState, index: int) -> Setting:
    """What arrives at an edit; at one too many, what the last one makes."""
    bound = state.bound
    while len(bound.steps) > index and bound.before is not None:
        bound = bound.before
    return bound.setting


def handle_points(raw: dict[str, Any], points: Tensor) -> list[int | None]:
    """Numbers of the points that handles are on; None of those given by the number of an anchor.

    Args:
        raw: the edit.
        points: (N, 3) as they arrive at it.
    """
    origin = triple(raw.get("origin"))
    return [
        None
        if one.get("near") is None
        else int((points - origin - triple(one["near"])).square().sum(dim=1).argmin())
        for one in raw["handles"]
    ]


def placed(raw: dict[str, Any], state: EditState, index: int) -> list[HandlePose]:
    """Where the handles of an edit are now.

    Args:
        raw: the edit, without keyframes.
        state: the object.
        index: of the edit.
    """
    points, origin = arriving(state, index).points, triple(raw.get("origin"))
    last = index + 1 == len(state.bound.steps)
    poses: list[HandlePose] = []
    for one, point in zip(raw["handles"], handle_points(raw, points), strict=True):
        place = origin + triple(one["to"])
        if point is not None:
            near = origin + triple(one["near"])
            place = near + raw.get("amount", 1.0) * (place - near)
            # What later edits do to the place is what they do to the point there.
            place = place if last else state.bound.setting.points[point]
        x, y, z = place.tolist()
        rests = one["to"] == one.get("near") and _turn(one) == STILL
        poses.append(HandlePose(place=(x, y, z), turn=_turn(one), rests=rests))
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
    one["to"] = (triple(one["to"]) + way_of(raw, before, after)).tolist()
    if is_turned(before, after):
        one = {key: one[key] for key in one if key not in ("axis", "angle_deg")}
        one["rotation"] = list(after.turn)
    handles = [one if k == number else other for k, other in enumerate(raw["handles"])]
    return {**raw, "handles": handles}


def mirrored(raw: dict[str, Any], number: int, mirror: Mirror, tolerance: float) -> dict[str, Any]:
    """Return an edit in which the handle on the other side does what one handle does.

    Args:
        raw: the edit, without keyframes.
        number: of the handle that leads.
        mirror: the plane between the sides, where `near` is measured.
        tolerance: how far from the image of its place the other one may be, world units.
    """
    one = raw["handles"][number]
    other = across(raw, number, mirror, tolerance)
    if other is None:
        return raw
    there = dict(raw["handles"][other])
    moved = triple(mirror.image(one["to"])) - triple(mirror.image(one["near"]))
    there["to"] = (triple(there["near"]) + moved).tolist()
    if one.get("rotation") is not None:
        there["rotation"] = list(mirror.turned(one["rotation"]))
    handles = [there if k == other else entry for k, entry in enumerate(raw["handles"])]
    return {**raw, "handles": handles}


def across(raw: dict[str, Any], number: int, mirror: Mirror, tolerance: float) -> int | None:
    """Number of the handle on the other side of a mirror; None where there is none."""
    near = raw["handles"][number].get("near")
    if near is None or abs(mirror.distance(near)) <= tolerance:
        return None
    image, found = triple(mirror.image(near)), list[tuple[float, int]]()
    for k, entry in enumerate(raw["handles"]):
        if k != number and entry.get("near") is not None:
            found.append((float((triple(entry["near"]) - image).norm()), k))
    away, other = min(found, default=(float("inf"), 0))
    return other if away <= tolerance else None


def _turn(one: dict[str, Any]) -> Quat:
    if one.get("rotation") is not None:
        w, x, y, z = one["rotation"]
        return w, x, y, z
    if one.get("axis") is None:
        return STILL
    return turn_about(one["axis"], math.radians(one.get("angle_deg", 0.0)))
