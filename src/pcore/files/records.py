"""Frozen dataclasses of plain values to JSON and back, strictly."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any, TypeVar, cast

from pydantic import TypeAdapter, ValidationError

from pcore.errors import CheckpointError

T = TypeVar("T")


def to_dict(record: Any) -> dict[str, Any]:
    """Return a dataclass as JSON knows it: dicts, lists, numbers, strings, None."""
    # Through the text and back, so that tuples compare equal to the lists read from a file.
    return cast("dict[str, Any]", json.loads(json.dumps(asdict(record), allow_nan=False)))


def from_dict(kind: type[T], data: Any, *, where: str) -> T:
    """Return the dataclass `kind` whose fields `data` holds, all of them and no others.

    Defaults are not filled in: a file that lacks a key was written by another version, whose
    default may have been another one.

    Args:
        kind: a dataclass; its fields may be dataclasses.
        data: what `to_dict` returned.
        where: what is read, for messages ("RUN/model.safetensors: config").

    Raises:
        CheckpointError: a key is unknown, missing or of another type, or the values do not pass
            the checks of the dataclass.
    """
    try:
        record = TypeAdapter(kind).validate_json(json.dumps(data), strict=True)
    except ValidationError as error:
        raise CheckpointError(f"{where}: {_explain(error)}; {_MEND}") from error
    try:
        complete = to_dict(record)
    except ValueError as error:
        raise CheckpointError(f"{where}: expected finite numbers, got others; {_MEND}") from error
    problems = _compare_keys(data, complete, "")
    if problems:
        raise CheckpointError(f"{where}: {', '.join(problems)}; {_MEND}")
    return record


_MEND = "it was written by another version of pcore or edited; install the version that wrote it"


def differing_keys(old: Any, new: Any, prefix: str = "") -> list[str]:
    """Return "key.path: old -> new" for every leaf in which two JSON values differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        a, b = cast("dict[str, Any]", old), cast("dict[str, Any]", new)
        lines: list[str] = []
        for key in sorted({*a, *b}):
            lines += differing_keys(
                a.get(key, _ABSENT), b.get(key, _ABSENT), f"{prefix}.{key}" if prefix else key
            )
        return lines
    # A later pcore added the setting, and null leaves it unused.
    unused = {id(old), id(new)} == {id(_ABSENT), id(None)}
    return [] if old == new or unused else [f"{prefix}: {_show(old)} -> {_show(new)}"]


_ABSENT = object()


def _show(value: Any) -> str:
    return "(absent)" if value is _ABSENT else json.dumps(value)


def _explain(error: ValidationError) -> str:
    """Return pydantic's findings in one line: where, what was wrong, what was found."""
    parts: list[str] = []
    for item in error.errors(include_url=False):
        key = ".".join(str(step) for step in item["loc"]) or "values"
        if item["type"] == "missing":
            parts.append(f"missing key '{key}'")
        elif item["type"] == "value_error":
            parts.append(f"'{key}': {item['ctx']['error'] if 'ctx' in item else item['msg']}")
        else:
            parts.append(f"'{key}': {item['msg'].lower()}, got {item['input']!r:.60}")
    return ", ".join(parts)


def _compare_keys(given: Any, complete: Any, prefix: str) -> list[str]:
    """Name the keys of `given` that `complete` lacks (unknown) and the other way (missing)."""
    if not (isinstance(given, dict) and isinstance(complete, dict)):
        return []
    a, b = cast("dict[str, Any]", given), cast("dict[str, Any]", complete)
    problems = [f"unknown key '{prefix}{key}'" for key in a if key not in b]
    problems += [f"missing key '{prefix}{key}'" for key in b if key not in a]
    for key in a.keys() & b.keys():
        problems += _compare_keys(a[key], b[key], f"{prefix}{key}.")
    return sorted(problems)
