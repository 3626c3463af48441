"""The text of an edit file, read and written, and what is wrong with an entry of it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast, get_args

from pydantic import BaseModel, ValidationError

from pcore.data.file_kinds import kind_of
from pcore.editing.regions import REGION, REGION_SHAPES, RegionEntry
from pcore.errors import EditError
from pcore.files.atomic import write_atomically
from pcore.validation import parse_json, read_text

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
    if not path.exists():
        raise EditError(f"{path}: edit file not found; expected a JSON file")
    kind = None
    if path.is_file():
        with path.open("rb") as file:
            kind = kind_of(file.read(64))
    if kind not in (None, "JSON text"):
        raise EditError(f"{path}: expected an edit file in JSON, got {kind}; give another file")
    text = read_text(path, where=str(path), error=EditError)
    once = partial(_without_duplicates, path)
    return parse_json(text, where=str(path), error=EditError, make=once)


def write_edit_file(path: Path | str, text: str) -> None:
    """Write the text of an edit file; an existing file is replaced in one step.

    Raises:
        EditError: it cannot be written.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise EditError(f"{path}: expected an existing folder to write to, got {path.parent}")
    try:
        write_atomically(path, text.encode())
    except OSError as error:
        raise EditError(
            f"{path}: cannot write the edit file ({error.strerror}); "
            "expected a place that can be written to"
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
    said = [_problem(kind, raw, name, allowed, key, "extra_forbidden") for key in unknown]
    known = {key: value for key, value in raw.items() if key in allowed}
    try:
        entry = kind.model_validate(known, context={"folder": folder})
    except ValidationError as error:
        details = error.errors()
        inner = [_within(kind, raw, detail["loc"], detail) for detail in details]
        # Where one thing in a list is wrong, nothing is gained by calling the list wrong as well.
        told = {_first(one["loc"]) for one, text in zip(details, inner, strict=True) if text}
        for detail, text in zip(details, inner, strict=True):
            key = _first(detail["loc"])
            if text or key not in told:
                said.append(text or _problem(kind, raw, name, allowed, key, _why(detail)))
        # A list of three wrong numbers is one mistake.
        raise EditError("; ".join(dict.fromkeys(said))) from error
    if said:
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


def _first(where: tuple[int | str, ...]) -> str:
    return str(where[0]) if where else ""


def _why(detail: Any) -> str:
    """Kind of a mistake in one key, or the text of a check of several."""
    return str(detail["type"]) if detail["loc"] else _text(detail)


def _text(detail: Any) -> str:
    return str(detail["msg"]).removeprefix("Value error, ")


def _within(
    kind: type[BaseModel], raw: Mapping[str, Any], where: tuple[int | str, ...], detail: Any
) -> str:
    """What is wrong with an object in a list, such as a handle; empty for other mistakes."""
    if len(where) < 2 or not isinstance(where[1], int):
        return ""
    key, index = str(where[0]), where[1]
    items = raw[key]
    if index >= len(items) or not isinstance(items[index], Mapping):
        return ""
    place, name = f'key "{key}", number {index + 1}: ', key.removesuffix("s")
    if len(where) == 2:
        return place + _text(detail)
    inner: type[BaseModel] = get_args(kind.model_fields[key].annotation)[0]
    fields = cast("Mapping[str, Any]", items[index])
    known = list(inner.model_fields)
    return place + _problem(inner, fields, name, known, str(where[2]), detail["type"])


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


def _without_duplicates(path: Path, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """JSON would silently keep the last of two equal keys."""
    result: dict[str, Any] = {}
    for key, value in pairs:
        if key in result:
            raise EditError(f'{path}: expected every key once, got "{key}" twice in one object')
        result[key] = value
    return result
