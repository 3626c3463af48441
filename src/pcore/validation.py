"""Checks shared by every public edge: user JSON, what pydantic found, whole numbers."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from pcore.errors import InputError, PcoreError

Model = TypeVar("Model", bound=BaseModel)


class Strict(BaseModel):
    """Base of what files of users hold: known keys alone, each of its own type."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


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
    """Parse a JSON file that a user gave, in UTF-8, UTF-16 or UTF-32, with or without a mark.

    Args:
        path: the file.
        what: what the file is to the user, for the message ("scene file", "edit file").
        error: the class to raise when the file is missing, unreadable or not JSON.
    """
    where = f"{what} {path}"
    return parse_json(read_text(path, where=where, error=error), where=where, error=error)


def read_text(path: Path, *, where: str, error: type[PcoreError]) -> str:
    """Read a text file that a user gave; its encoding is told by its first bytes, as in RFC 4627.

    Editors and tools of Windows write a byte order mark, or UTF-16.

    Args:
        path: the file.
        where: what the file is, with its path; starts the message.
        error: the class to raise when it is missing, unreadable or no text.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise error(f"{where}: no such file; check the path") from None
    except OSError as problem:
        raise error(f"{where}: cannot be read ({problem.strerror})") from problem
    encoding = json.detect_encoding(content)
    try:
        return content.decode(encoding).removeprefix("\ufeff")
    except UnicodeDecodeError as problem:
        name = encoding.upper().removesuffix("-SIG")
        raise error(
            f"{where}: expected text in UTF-8, got bytes that are not {name} "
            f"(from byte {problem.start:,}); save it as UTF-8"
        ) from problem


def read_bytes(path: Path, *, what: str) -> bytes:
    """Content of a binary file that a user gave.

    Args:
        path: the file.
        what: what it should be, for the message ("a file of Gaussians").

    Raises:
        InputError: it is missing or cannot be read.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; expected {what}") from None
    except OSError as problem:
        raise InputError(f"{path}: cannot read {what}: {problem.strerror}") from problem


def parse_json(
    text: str,
    *,
    where: str,
    error: type[PcoreError],
    make: Callable[[list[tuple[str, Any]]], Any] = dict,
) -> Any:
    """Parse JSON text that a user gave.

    Args:
        text: the text.
        where: what the text is, with its file; starts the message.
        error: the class to raise when it is not JSON.
        make: makes an object of its keys and values.
    """
    if not text.strip():
        raise error(f"{where}: expected JSON, got an empty file; was it copied whole?")
    try:
        return json.loads(text, object_pairs_hook=make)
    except json.JSONDecodeError as problem:
        raise error(
            f"{where}: expected JSON, got text that does not parse {_broken(problem)}"
        ) from problem
    except (RecursionError, ValueError) as problem:
        raise error(
            f"{where}: expected JSON, got text that does not parse: lists in lists too deep, or a "
            "number of thousands of digits"
        ) from problem


def _broken(problem: json.JSONDecodeError) -> str:
    """Where text stops being JSON, why where that is known, and the line that it is in."""
    text, at = problem.doc, problem.pos
    rest = text[at:].lstrip()
    # Whether the parser stops at a comma too many or behind it depends on the version of Python.
    comma = at if text[at : at + 1] == "," else len(text[:at].rstrip()) - 1
    behind = text[comma + 1 :].lstrip()
    if not rest:
        reason = "where the text ends; was the file cut off?"
    elif rest.startswith(("//", "/*", "#")):
        reason = "where a comment begins, which JSON does not have; delete it"
    elif comma >= 0 and text[comma] == "," and behind.startswith(("]", "}")):
        at, reason = comma, f"where a comma stands before {behind[0]!r}; delete the comma"
    elif rest.startswith("'"):
        reason = "where a single quote stands; JSON has double quotes"
    else:
        reason = f"from {rest[:20].splitlines()[0]!r} on; was the file cut off or edited by hand?"
    before, number = text.rfind("\n", 0, at) + 1, text.count("\n", 0, at) + 1
    line = text[before:].split("\n", 1)[0].strip()
    shown = line if len(line) <= 60 else line[:57] + "..."
    return f"at line {number}, column {at - before + 1}, {reason} ({shown})"


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
    field = _field(first["loc"])
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    unknown = next((one for one in details if one["type"] == "extra_forbidden"), None)
    if first["type"] == "missing" and unknown is not None:
        odd = _field(unknown["loc"])
        return f"'{field}' is missing, and '{odd}' is not a known key; add it or mend its spelling"
    if first["type"] == "missing":
        return f"'{field}' is missing{more}; add it"
    if first["type"] == "extra_forbidden":
        return f"'{field}' is not a known key{more}; remove it or mend its spelling"
    wanted = _KINDS.get(first["type"])
    if first["type"] == "too_short":
        kind = "keys" if isinstance(first["input"], dict) else "a list"
        wanted = f"{kind} of at least {first.get('ctx', {}).get('min_length', 1)}"
    message = f"expected {wanted}" if wanted else first["msg"]
    got = _JSON_NAMES.get(repr(first["input"]), repr(first["input"]))
    short = got if len(got) <= 60 else got[:57] + "..."
    return f"'{field}': {message}, got {short}{more}"


def _field(place: tuple[int | str, ...]) -> str:
    return ".".join(str(part) for part in place) or "top level"


def check_folder_names(where: str, names: Collection[str]) -> None:
    """Raise InputError unless names that somebody gave to things can be those of their folders."""
    for name in names:
        if not _FOLDER_NAME.fullmatch(name):
            raise InputError(
                f"{where}: expected names that can be folders, of letters, digits, '.', '_' and "
                f"'-', the first a letter or digit, 64 at most; got {name!r}"
            )
    # Some disks do not tell case apart.
    if len({name.lower() for name in names}) < len(names):
        raise InputError(
            f"{where}: expected names that differ by more than case, got {', '.join(names)}; "
            "rename one"
        )


_FOLDER_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


# Where pydantic speaks of Python's types, which users of a JSON file need not know.
_KINDS = {
    "model_type": "keys with values { ... }",
    "model_attributes_type": "keys with values { ... }",
    "dict_type": "keys with values { ... }",
    "tuple_type": "a list [ ... ]",
    "list_type": "a list [ ... ]",
    "string_type": "text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
}
_JSON_NAMES = {"None": "null", "True": "true", "False": "false"}
