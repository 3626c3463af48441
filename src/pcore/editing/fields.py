"""The kinds of value that the keys of an edit file take.

The `description` of a field completes the sentence "expected ..." in error messages, so that the
rule and its message stand together.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, cast

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    SerializationInfo,
    ValidationInfo,
)

from pcore.deform.frame import axis_vector
from pcore.errors import InputError


def _axis(value: Any) -> str | tuple[float, float, float]:
    if isinstance(value, (list, tuple)):
        items = cast("list[Any]", list(value))
        if any(isinstance(item, bool) or not isinstance(item, (int, float)) for item in items):
            raise ValueError("not numbers")
        try:
            value = tuple(float(item) for item in items)
        except OverflowError as error:
            raise ValueError("integer too large") from error
    elif not isinstance(value, str):
        raise ValueError("neither a name nor a vector")
    try:
        axis_vector(value)
    except InputError as error:
        raise ValueError(str(error)) from error
    return value


def _limits(value: tuple[float, float]) -> tuple[float, float]:
    if not 0.0 <= value[0] < value[1] <= 1.0:
        raise ValueError("limits out of order")
    return value


def _extent(value: tuple[float, float]) -> tuple[float, float]:
    if not value[0] < value[1]:
        raise ValueError("extent out of order")
    return value


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Triple = tuple[Number, Number, Number]
AXIS = '"x", "y", "z" or a non-zero vector [x, y, z] of finite numbers'
EXTENT = "two finite numbers [lo, hi] with lo < hi, world units from the origin"
# Serialised as it is: pydantic knows nothing about what a plain validator returns.
Axis = Annotated[
    str | tuple[float, float, float],
    PlainValidator(_axis),
    PlainSerializer(lambda axis: axis, return_type=Any),
]
Limits = Annotated[
    tuple[Number, Number],
    AfterValidator(_limits),
    Field(description="two numbers [first, second] with 0 <= first < second <= 1"),
]
Extent = Annotated[tuple[Number, Number], AfterValidator(_extent)]
Angle = Annotated[Number, Field(description="a finite number of degrees")]
Factor = Annotated[Number, Field(description="a finite number")]
Positive = Annotated[
    Number,
    Field(gt=0, description="a finite number above 0 (0 is a singular deformation, less mirrors)"),
]
Amount = Annotated[
    Number, Field(description="a finite number: 0 changes nothing, 1 is the whole edit")
]
Length = Annotated[Number, Field(ge=0, description="a length of 0 or more, world units")]


def _found_from(value: Any, info: ValidationInfo) -> Any:
    """A path in an edit file is meant from the folder of that file."""
    if not isinstance(value, str):
        return value
    if not value:
        raise ValueError("no path")
    if "\0" in value:
        raise ValueError("a path with a zero byte")
    folder: Any = (info.context or {}).get("folder")
    return str(Path(folder or ".").absolute() / value)


def _written_from(value: Any, info: SerializationInfo) -> Any:
    folder: Any = (info.context or {}).get("folder")
    return seen_from(folder, value) if isinstance(value, str) else value


def seen_from(folder: Path | str | None, file: str) -> str:
    """Files beside or below an edit file are named as seen from it, so that both can move."""
    path = Path(file)
    if folder is None or not path.is_relative_to(Path(folder).absolute()):
        return file
    return path.relative_to(Path(folder).absolute()).as_posix()


def _quaternion(value: tuple[float, ...]) -> tuple[float, ...]:
    if not math.hypot(*value) > 0:
        raise ValueError("no direction")
    return value


ROTATION = "a quaternion [w, x, y, z] of any length but 0"
Rotation = Annotated[tuple[Number, Number, Number, Number], AfterValidator(_quaternion)]

FILE_KEYS = ("before", "after", "file", "first", "second")
"""Keys of edits and regions whose text is a path."""
StoredFile = Annotated[
    str,
    Field(strict=True),
    AfterValidator(_found_from),
    PlainSerializer(_written_from, return_type=str),
]


class Between(BaseModel):
    """A shape between two files: what an edit with keyframes of shapes has between two of them."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    first: StoredFile
    second: StoredFile
    share: Annotated[Number, Field(ge=0, le=1)]
    """0 is the first, 1 the second; every place goes straight from one to the other."""


StoredPlaces = Annotated[
    Annotated[str, Field(strict=True)] | Between | tuple[Triple, ...],
    AfterValidator(_found_from),
    PlainSerializer(_written_from, return_type=Any),
]
"""A file, something between two files, or the places themselves."""


def check_turn(
    axis: str | tuple[float, float, float] | None,
    angle_deg: float,
    rotation: tuple[float, ...] | None,
) -> None:
    """Raise ValueError when an edit has an angle and nothing to turn about, or two turns."""
    if rotation is not None and (axis is not None or angle_deg != 0.0):
        raise ValueError(
            '"rotation": expected either a "rotation" or an "axis" with "angle_deg", got both'
        )
    if rotation is None and axis is None and angle_deg != 0.0:
        raise ValueError(
            '"axis": expected "x", "y", "z" or [x, y, z] to turn about because "angle_deg" '
            f"is {angle_deg}, got none"
        )


def turn_of(
    axis: str | tuple[float, float, float] | None,
    angle_deg: float,
    rotation: tuple[float, ...] | None,
) -> tuple[str | tuple[float, float, float], float]:
    """Axis and angle in radians of a turn that is given in either way; the shorter way round."""
    if rotation is None:
        return "z" if axis is None else axis, math.radians(angle_deg)
    sign = -1.0 if rotation[0] < 0 else 1.0
    w, x, y, z = (sign * one for one in rotation)
    length = math.hypot(x, y, z)
    if length == 0:
        return "z", 0.0
    return (x / length, y / length, z / length), 2 * math.atan2(length, w)
