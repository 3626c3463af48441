"""The one handle of an edit by a formula: its centre and axis, or what it moves."""

from __future__ import annotations

import math
from typing import Any

from pcore.editing.fields import turn_of
from pcore.editing.part import PartEdit
from pcore.editing.regions import Setting
from pcore.editing.script import parse_one
from pcore.studio.handle_pose import (
    STILL,
    HandlePose,
    axis_of,
    is_turned,
    triple,
    turn_about,
    turn_to,
)

CENTRED = ("twist", "bend", "taper", "stretch", "scale")
"""Kinds whose handle is their centre and, but for "scale", their axis."""
MOVING = ("rigid", "part")
"""Kinds whose handle is what they move: dragging it drags that."""


def formula_handle(raw: dict[str, Any], setting: Setting) -> HandlePose:
    """Where the handle is.

    Args:
        raw: the edit, without keyframes, of a kind of `CENTRED` or `MOVING`.
        setting: what arrives at it.
    """
    if raw["type"] in CENTRED:
        turn = turn_to(raw["axis"]) if "axis" in raw else STILL
        return HandlePose(place=_place(triple(raw.get("origin"))), turn=turn)
    center = triple(raw.get("origin"))
    if raw["type"] == "part":
        edit = parse_one(raw)
        assert isinstance(edit, PartEdit)
        center = edit.pivot(setting)
    turn = turn_of(raw.get("axis"), raw.get("angle_deg", 0.0), raw.get("rotation"))
    place = _place(center + triple(raw.get("translation")))
    return HandlePose(place=place, turn=turn_about(*turn))


def with_formula_handle(
    raw: dict[str, Any], before: HandlePose, after: HandlePose
) -> dict[str, Any]:
    """Return an edit with its handle moved and turned.

    Args:
        raw: the edit, without keyframes.
        before: where the handle is shown.
        after: where it is to be.
    """
    key = "origin" if raw["type"] in CENTRED else "translation"
    changed = {**raw, key: (triple(raw.get(key)) + _way(before, after)).tolist()}
    if not is_turned(before, after) or raw["type"] == "scale":
        return changed
    if raw["type"] in CENTRED:
        return {**changed, "axis": axis_of(after.turn)}
    w, x, y, z = after.turn
    length = math.hypot(x, y, z)
    changed.pop("rotation", None)
    # As an axis with an angle, so that its slider goes on with it.
    angle = 2 * math.degrees(math.atan2(length, w))
    changed["angle_deg"] = angle - 360.0 if angle > 180.0 else angle
    if length > 0:
        changed["axis"] = [x / length, y / length, z / length]
    return changed


def _way(before: HandlePose, after: HandlePose) -> Any:
    return triple(after.place) - triple(before.place)


def _place(values: Any) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
