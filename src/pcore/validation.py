"""Checks shared by every public edge: user JSON, what pydantic found, whole numbers."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from pcore.errors import InputError, PcoreError

Model = TypeVar("Model", bound=BaseModel)


def check_count(name: str, value: object, *, minimum: int = 1) -> int:
    """Return `value` when it is a whole number of at least `minimum`; InputError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
        raise InputError(f"{name}: expected a whole number of at least {minimum}, got {value!r}")
    return value


def first_names(names: Iterable[str]) -> str:
    """Up to three names in order, for messages: "a, b, c, ..."; empty when there are none."""
    found = sorted(names)
    return ", ".join(found[:3]) + ", ..." * (len(found) > 3)


def read_json(path: Path, *, what: str, error: type[PcoreError]) -> Any:
    """Parse a JSON file that a user gave.

    Args:
        path: the file.
        what: what the file is to the user, for the message ("scene file", "edit file").
        error: the class to raise when the file is missing, unreadable or not JSON.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise error(f"{what} {path}: no such file; check the path") from None
    except (OSError, UnicodeDecodeError) as problem:
        raise error(f"{what} {path}: cannot be read as UTF-8 text ({problem})") from problem
    try:
        return json.loads(text)
    except (json.JSONDecodeError, RecursionError) as problem:
        raise error(
            f"{what} {path}: expected JSON, got text that does not parse ({problem}); "
            "was the file cut off?"
        ) from problem


def parse(model: type[Model], data: object, *, where: str, error: type[PcoreError]) -> Model:
    """Validate `data` with a pydantic model; raise `error` naming the first wrong field.

    Args:
        model: the pydantic class.
        data: what was read.
        where: file (and entry) that the data came from; starts the message.
        error: the class to raise.
    """
    try:
        return model.model_validate(data)
    except ValidationError as problem:
        raise error(f"{where}: {describe_problem(problem)}") from problem


def describe_problem(problem: ValidationError) -> str:
    """First finding of pydantic as "field: what was expected, got value"."""
    details = problem.errors(include_url=False)
    first = details[0]
    field = ".".join(str(part) for part in first["loc"]) or "top level"
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    if first["type"] == "missing":
        return f"'{field}' is missing{more}; add it"
    if first["type"] == "extra_forbidden":
        return f"'{field}' is not a known key{more}; remove it or mend its spelling"
    wanted = _KINDS.get(first["type"])
    message = f"expected {wanted}" if wanted else first["msg"]
    got = repr(first["input"])
    short = got if len(got) <= 60 else got[:57] + "..."
    return f"'{field}': {message}, got {short}{more}"


# Where pydantic speaks of Python's types, which users of a JSON file need not know.
_KINDS = {
    "model_type": "a JSON object { ... }",
    "model_attributes_type": "a JSON object { ... }",
    "tuple_type": "a list [ ... ]",
    "list_type": "a list [ ... ]",
}
