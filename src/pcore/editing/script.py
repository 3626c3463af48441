"""The edit file: a list of deformations, the same for every command (docs/guide/edit-files.md)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import torch
from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError
from torch import Tensor

from pcore.deform.base import Compose, Deformation, Identity
from pcore.deform.checks import check_invertible
from pcore.editing.edits import (
    EDIT_TYPES,
    BendEdit,
    Edit,
    RigidEdit,
    ScaleEdit,
    StretchEdit,
    TaperEdit,
    TwistEdit,
)
from pcore.errors import EditError, InputError

__all__ = ["EditScript", "check_invertible", "load_edit", "parse_edit"]

_VERSION = 1
_HINTS = {
    ("scale", "axis"): 'a scale is uniform; for one direction use a stretch with profile "axial"',
    ("rigid", "factor"): "a rigid edit keeps sizes; use a scale",
}

AnyEdit = Annotated[
    TwistEdit | BendEdit | TaperEdit | StretchEdit | ScaleEdit | RigidEdit,
    Field(discriminator="type"),
]


class EditScript(BaseModel):
    """A list of edits that are applied in order, in world units.

    Made by `load_edit` or `parse_edit`, which raise EditError; constructing it directly raises
    pydantic's ValidationError.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    version: Literal[1] = 1
    edits: tuple[AnyEdit, ...]
    _source: str = PrivateAttr(default="edit script")

    def __eq__(self, other: object) -> bool:
        """Compare edits; where a script was read from does not matter."""
        return isinstance(other, EditScript) and self.edits == other.edits

    def __hash__(self) -> int:
        return hash(self.edits)

    def named(self, source: str) -> EditScript:
        """Return the same script under the name that its error messages use, such as its file."""
        copy = self.model_copy()
        copy._source = source
        return copy

    def bind(self, points: Tensor, *, allow_folds: bool = False) -> Deformation:
        """Freeze the script to points (N, 3), world units, and return its deformation.

        An edit without `extent` takes it from these points as they arrive at that edit, after
        the ones before it, as Blender's modifier stack does.

        Args:
            points: (N, 3) the canonical cloud of a run, or whatever is to be deformed.
            allow_folds: accept maps that fold space at some (not all) of the points; enough for
                moving bare points, not for rendering.

        Raises:
            EditError: no extent to take, or a singular deformation (see `check_invertible`).
        """
        if points.ndim != 2 or points.shape[-1] != 3:
            raise EditError(f"{self._source}: expected points (N, 3), got {tuple(points.shape)}")
        moving = points.detach().to(device="cpu", dtype=torch.float64)
        steps: list[Deformation] = []
        for number, edit in enumerate(self.edits, start=1):
            try:
                step = edit.bind(moving)
                check_invertible(step, moving, allow_folds=allow_folds)
            except (EditError, InputError) as error:
                raise EditError(f"{_place(self._source, number, edit.type)}: {error}") from error
            moving = step(moving)
            steps.append(step)
        if not steps:
            return Identity()
        return steps[0] if len(steps) == 1 else Compose(*steps)

    def to_json(self) -> str:
        """Text of an edit file that reads back as an equal script."""
        edits = [
            {"type": edit.type, **edit.model_dump(mode="json", exclude_none=True)}
            for edit in self.edits
        ]
        return json.dumps({"version": self.version, "edits": edits}, indent=2) + "\n"

    def save(self, path: Path | str) -> None:
        """Write `to_json` to a file; an existing file is replaced in one step.

        Raises:
            EditError: the file cannot be written.
        """
        path = Path(path)
        if not path.parent.is_dir():
            raise EditError(f"{path}: expected an existing folder to write to, got {path.parent}")
        partial = path.with_name(f".{path.name}.partial")
        try:
            partial.write_text(self.to_json(), encoding="utf-8")
            partial.replace(path)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise EditError(
                f"{path}: cannot write the edit file ({error.strerror}); "
                "expected a place that can be written to"
            ) from error


def load_edit(path: Path | str) -> EditScript:
    """Read an edit file.

    Raises:
        EditError: missing or not JSON, another version, or an edit that is not valid; the
            message names the file, the edit by number from 1, and the key.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise EditError(f"{path}: edit file not found; expected a JSON file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise EditError(
            f"{path}: cannot read the edit file, expected JSON text: {error}"
        ) from error
    try:
        data = json.loads(text, object_pairs_hook=_without_duplicates)
    except EditError as error:
        raise EditError(f"{path}: {error}") from error
    except (ValueError, RecursionError) as error:
        raise EditError(
            f"{path}: expected an edit file in JSON, got invalid JSON: {error}"
        ) from error
    return parse_edit(data, source=str(path))


def parse_edit(data: Any, *, source: str = "edit script") -> EditScript:
    """Check the content of an edit file (parsed JSON) and return it as a script.

    Args:
        data: the object of the file.
        source: what messages call it.

    Raises:
        EditError: as for `load_edit`.
    """
    if not isinstance(data, dict):
        raise EditError(
            f'{source}: expected an object {{"version": 1, "edits": [...]}}, got {_shown(data)}'
        )
    content = cast("dict[str, Any]", data)
    unknown = sorted(set(content) - {"version", "edits"})
    if unknown:
        raise EditError(
            f'{source}: unknown key {_quoted(unknown)}, expected only "version" and "edits"'
        )
    version = content.get("version")
    if isinstance(version, bool) or version != _VERSION:
        got = "no such key" if "version" not in content else _shown(version)
        raise EditError(
            f'{source}: expected "version": {_VERSION}, got {got}; this pcore reads only '
            f"version {_VERSION} of the edit file"
        )
    edits = content.get("edits")
    if not isinstance(edits, (list, tuple)):
        got = "no such key" if "edits" not in content else _shown(edits)
        raise EditError(f'{source}: expected "edits": a list of edits, got {got}')
    items = cast("list[Any]", list(edits))
    parsed = [_parse_one(item, number, source) for number, item in enumerate(items, start=1)]
    return EditScript(edits=cast("Any", tuple(parsed))).named(source)


def _parse_one(item: Any, number: int, source: str) -> Edit:
    if not isinstance(item, dict):
        raise EditError(f"{source}: edit {number}: expected an object, got {_shown(item)}")
    raw = cast("dict[str, Any]", item)
    name = raw.get("type")
    if not isinstance(name, str) or name not in EDIT_TYPES:
        got = "no such key" if "type" not in raw else _shown(name)
        raise EditError(
            f'{source}: edit {number}: key "type": expected one of {_quoted(EDIT_TYPES)}, got {got}'
        )
    try:
        return EDIT_TYPES[name].model_validate(raw)
    except ValidationError as error:
        kinds: dict[str, str] = {}
        for detail in error.errors():
            key = str(detail["loc"][0]) if detail["loc"] else ""
            kinds.setdefault(key, detail["type"])
            if not key:
                kinds[key] = str(detail["msg"]).removeprefix("Value error, ")
        problems = [_problem(EDIT_TYPES[name], raw, key, kind) for key, kind in kinds.items()]
        raise EditError(f"{_place(source, number, name)}: {'; '.join(problems)}") from error


def _problem(kind: type[Edit], raw: dict[str, Any], key: str, error: str) -> str:
    """Say what is wrong with one key; an empty key stands for several keys together."""
    if not key:
        return error
    name = str(raw["type"])
    if error == "extra_forbidden":
        allowed = _quoted(list(kind.model_fields))
        hint = _HINTS.get((name, key))
        return f'unknown key "{key}" for a {name}, expected only {allowed}' + (
            f" ({hint})" if hint else ""
        )
    expected = kind.model_fields[key].description
    got = _shown(raw[key]) if key in raw else "no such key"
    return f'key "{key}": expected {expected}, got {got}'


def _place(source: str, number: int, name: str) -> str:
    return f"{source}: edit {number} ({name})"


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """JSON would silently keep the last of two equal keys."""
    result: dict[str, Any] = {}
    for key, value in pairs:
        if key in result:
            raise EditError(f'expected every key once, got "{key}" twice in one object')
        result[key] = value
    return result


def _shown(value: Any) -> str:
    text = json.dumps(value, default=repr)
    return text if len(text) <= 60 else text[:57] + "..."


def _quoted(names: Any) -> str:
    return ", ".join(f'"{name}"' for name in names)
