"""Where a handle of the page is and how it is turned."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from pcore.deform.frame import AXIS_NAMES, axis_vector
from pcore.geometry.rotation import rotations

Quat = tuple[float, float, float, float]
STILL: Quat = (1.0, 0.0, 0.0, 0.0)
_SAME = 1e-9


@dataclass(frozen=True, kw_only=True)
class HandlePose:
    """Where a handle is and how it is turned.

    Attributes:
        place: (3,) world units.
        turn: unit quaternion w, x, y, z.
        rests: it is where it was put, and holds that place.
    """

    place: tuple[float, float, float]
    turn: Quat = STILL
    rests: bool = False


def triple(values: Any) -> Tensor:
    """(3,) float64 of three numbers; None is the origin."""
    return torch.tensor([0.0] * 3 if values is None else list(values), dtype=torch.float64)


def turn_about(axis: str | Sequence[float], radians: float) -> Quat:
    """The turn by an angle about an axis."""
    x, y, z = (axis_vector(axis) * math.sin(radians / 2)).tolist()
    return math.cos(radians / 2), x, y, z


def turn_to(axis: str | Sequence[float]) -> Quat:
    """The shortest turn that brings z to an axis."""
    x, y, z = axis_vector(axis).tolist()
    if z < _SAME - 1:
        return 0.0, 1.0, 0.0, 0.0
    length = math.sqrt(2 * (1 + z))
    return length / 2, -y / length, x / length, 0.0


def axis_of(turn: Quat) -> str | list[float]:
    """Where a turn brings z: by its name, or (3,) of unit length."""
    z = rotations(torch.tensor(turn, dtype=torch.float64))[:, 2]
    for name in AXIS_NAMES:
        if float(z @ axis_vector(name)) > 1 - _SAME:
            return name
    return z.tolist()


def degrees_of(turn: Quat) -> tuple[float, float, float]:
    """Angles about the fixed axes x, then y, then z that make a turn; degrees."""
    m = rotations(torch.tensor(turn, dtype=torch.float64))
    tilt = math.asin(max(-1.0, min(1.0, -float(m[2, 0]))))
    if abs(math.cos(tilt)) < 1e-6:  # x and z turn about the same line: all of it counts as z.
        return 0.0, math.degrees(tilt), math.degrees(math.atan2(-float(m[0, 1]), float(m[1, 1])))
    about_x = math.atan2(float(m[2, 1]), float(m[2, 2]))
    about_z = math.atan2(float(m[1, 0]), float(m[0, 0]))
    return math.degrees(about_x), math.degrees(tilt), math.degrees(about_z)


def turn_of_degrees(degrees: Sequence[float]) -> Quat:
    """The turn by angles about x, then y, then z; see `degrees_of`."""
    turn = STILL
    for name, angle in zip(AXIS_NAMES, degrees, strict=True):
        turn = _after(turn_about(name, math.radians(angle)), turn)
    return turn


def is_turned(before: HandlePose, after: HandlePose) -> bool:
    """Whether a handle was turned by more than the rounding of a page."""
    return _cosine(before, after) < 1 - _SAME


def way_between(one: HandlePose, other: HandlePose) -> str:
    """How far one handle is from another in world units, and in degrees where they are turned."""
    away = float((triple(one.place) - triple(other.place)).norm())
    said = [f"{away:.2g}"] if away > _SAME else []
    if is_turned(one, other):
        angle = 2 * math.acos(min(1.0, _cosine(one, other)))
        said.append(f"{math.degrees(angle):.0f}\N{DEGREE SIGN}")
    return " and ".join(said)


def _cosine(one: HandlePose, other: HandlePose) -> float:
    """Of half the angle between two turns."""
    return abs(sum(a * b for a, b in zip(one.turn, other.turn, strict=True)))


def way_of(raw: dict[str, Any], before: HandlePose, after: HandlePose) -> Tensor:
    """(3,) by which an edit must move a handle whole to move it so far at its own amount."""
    share = max(float(raw.get("amount", 1.0)), 1e-3)
    return (triple(after.place) - triple(before.place)) / share


def _after(second: Quat, first: Quat) -> Quat:
    (a, b, c, d), (w, x, y, z) = second, first
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )
