"""Reading the text of an edit file, and saying what is wrong with an entry of it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar, cast

from pydantic import BaseModel, ValidationError

from pcore.editing.regions import REGION, REGION_SHAPES, RegionEntry
from pcore.errors import EditError

Entry = TypeVar("Entry", bound=BaseModel)

HINTS = {
    ("scale", "axis"): 'a scale is uniform; for one direction use a stretch with profile "axial"',
    ("rigid", "factor"): "a rigid edit keeps sizes; use a scale, or a part",
}


def read_edit_file(path: Path) -> Any:
    """Parse an edit file as JSON in which every key stands once.

    Raises:
        EditError: missing, not readable or not JSON.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise EditError(f"{path}: edit file not found; expected a JSON file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise EditError(
            f"{path}: cannot read the edit file, expected JSON text: {error}"
        ) from error
    try:
        return json.loads(text, object_pairs_hook=_without_duplicates)
    except EditError as error:
        raise EditError(f"{path}: {error}") from error
    except (ValueError, RecursionError) as error:
        raise EditError(
            f"{path}: expected an edit file in JSON, got invalid JSON: {error}"
        ) from error


def parse_entry(
    kind: type[Entry],
    raw: Mapping[str, Any],
    name: str,
    *,
    allowed: list[str],
    folder: Path | None,
) -> Entry:
    """Check one object of an edit file; EditError names all keys that are wrong.

    Args:
        kind: what it must be.
        raw: the object.
        name: its type or shape, for messages.
        allowed: the keys it may have.
        folder: where paths in it begin.
    """
    unknown = [key for key in raw if key not in allowed]
    problems: dict[str, str] = dict.fromkeys(unknown, "extra_forbidden")
    try:
        known = {key: value for key, value in raw.items() if key in allowed}
        entry = kind.model_validate(known, context={"folder": folder})
    except ValidationError as error:
        entry = None
        for detail in error.errors():
            key = str(detail["loc"][0]) if detail["loc"] else ""
            problems.setdefault(key, detail["type"])
            if not key:
                problems[key] = str(detail["msg"]).removeprefix("Value error, ")
    if entry is None or problems:
        said = [_problem(kind, raw, name, allowed, key, why) for key, why in problems.items()]
        raise EditError("; ".join(said))
    return entry


def parse_region(raw: Any, folder: Path | None) -> RegionEntry:
    """Check a region of an edit file.

    Raises:
        EditError: it is none.
    """
    if isinstance(raw, RegionEntry):
        return raw
    if not isinstance(raw, dict):
        raise EditError(f"expected {REGION}, got {shown(raw)}")
    content = cast("dict[str, Any]", raw)
    shape = content.get("shape")
    if not isinstance(shape, str) or shape not in REGION_SHAPES:
        got = "no such key" if "shape" not in content else shown(shape)
        raise EditError(f'key "shape": expected one of {quoted(REGION_SHAPES)}, got {got}')
    kind = REGION_SHAPES[shape]
    return parse_entry(kind, content, shape, allowed=list(kind.model_fields), folder=folder)


def _problem(
    kind: type[BaseModel],
    raw: Mapping[str, Any],
    name: str,
    allowed: list[str],
    key: str,
    why: str,
) -> str:
    """Say what is wrong with one key; an empty key stands for several keys together."""
    if not key:
        return why
    if why == "extra_forbidden":
        hint = HINTS.get((name, key))
        known = [one for one in allowed if one not in ("type", "shape")]
        return f'unknown key "{key}" for a {name}, expected only {quoted(known)}' + (
            f" ({hint})" if hint else ""
        )
    expected = kind.model_fields[key].description
    got = shown(raw[key]) if key in raw else "no such key"
    return f'key "{key}": expected {expected}, got {got}'


def shown(value: Any) -> str:
    """A value as it stands in the file, shortened."""
    text = json.dumps(value, default=repr)
    return text if len(text) <= 60 else text[:57] + "..."


def quoted(names: Any) -> str:
    """Names in quotes with commas."""
    return ", ".join(f'"{name}"' for name in names)


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """JSON would silently keep the last of two equal keys."""
    result: dict[str, Any] = {}
    for key, value in pairs:
        if key in result:
            raise EditError(f'expected every key once, got "{key}" twice in one object')
        result[key] = value
    return result
