"""The edit file: a list of deformations, the same for every command (docs/guide/edit-files.md)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, cast

import torch
from pydantic import BaseModel, ConfigDict, PrivateAttr
from torch import Tensor

from pcore.deform.base import Deformation
from pcore.deform.checks import check_invertible
from pcore.editing.anchors import AnchorRig
from pcore.editing.binding import Bound, begin
from pcore.editing.edits import Edit
from pcore.editing.keyframes import is_animated
from pcore.editing.reading import (
    parse_entry,
    parse_region,
    quoted,
    read_edit_file,
    shown,
    write_edit_file,
)
from pcore.editing.regions import AnyRegion, RegionEntry
from pcore.editing.registry import EDIT_TYPES, AnyEdit
from pcore.errors import EditError, InputError

__all__ = ["EditScript", "check_invertible", "load_edit", "parse_edit", "parse_one"]

VERSION = 2
_KEYS = ("version", "edits", "freeze")
_LEFT_OUT = ("region", "freeze")
"""Keys that are not written where they say that there is nothing."""


class EditScript(BaseModel):
    """A list of edits that are applied in order, in world units.

    Made by `load_edit` or `parse_edit`, which raise EditError; constructing it directly raises
    pydantic's ValidationError.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    version: Literal[2] = VERSION
    edits: tuple[AnyEdit, ...]
    freeze: tuple[AnyRegion, ...] = ()
    _source: str = PrivateAttr(default="edit script")

    def __eq__(self, other: object) -> bool:
        """Compare edits and frozen regions; where a script was read from does not matter."""
        if not isinstance(other, EditScript):
            return False
        return self.edits == other.edits and self.freeze == other.freeze

    def __hash__(self) -> int:
        return hash((self.edits, self.freeze))

    @property
    def source(self) -> str:
        """What messages call the script, such as its file."""
        return self._source

    def named(self, source: str) -> EditScript:
        """Return the same script under the name that its error messages use, such as its file."""
        copy = self.model_copy()
        copy._source = source
        return copy

    def bind(
        self, points: Tensor, *, allow_folds: bool = False, rig: AnchorRig | None = None
    ) -> Deformation:
        """Freeze the script to points (N, 3), world units, and return its deformation.

        An edit without `extent` takes it from these points as they arrive at that edit, after
        the ones before it, as Blender's modifier stack does; so do regions.

        Args:
            points: (N, 3) the canonical cloud of a run, or whatever is to be deformed.
            allow_folds: accept maps that fold space at some (not all) of the points; enough for
                moving bare points, not for rendering.
            rig: of the same points with learned weights; edits by its anchors use it, those that
                ask for other anchors do not.

        Raises:
            EditError: an edit does not fit the points (no extent to take, an empty region, a file
                of other points), or a singular deformation (see `check_invertible`).
        """
        return self.bound(points, allow_folds=allow_folds, rig=rig).deformation

    def bound(
        self,
        points: Tensor,
        *,
        allow_folds: bool = False,
        rig: AnchorRig | None = None,
        check: bool = True,
    ) -> Bound:
        """Do the same and keep the steps apart, so that more can be added.

        Args:
            points: see `bind`.
            allow_folds: see `bind`.
            rig: see `bind`.
            check: look for folds; without, any map is accepted that leaves the points finite, which
                is enough for plain rays.

        Raises:
            EditError: as `bind`.
        """
        if points.ndim != 2 or points.shape[-1] != 3:
            raise EditError(f"{self._source}: expected points (N, 3), got {tuple(points.shape)}")
        resting = points.detach().to(device="cpu", dtype=torch.float64)
        try:
            bound = begin(resting, self.freeze, allow_folds=allow_folds, rig=rig)
        except (EditError, InputError) as error:
            raise EditError(f"{self._source}: freeze: {error}") from error
        for number, edit in enumerate(self.edits, start=1):
            try:
                bound = bound.then(edit, check=check)
            except (EditError, InputError) as error:
                raise EditError(f"{self._source}: edit {number} ({edit.type}): {error}") from error
        return bound

    def to_json(self, folder: Path | str | None = None) -> str:
        """Text of an edit file that reads back as an equal script.

        Args:
            folder: where the file will be; files in it and below are then named as seen from it.
        """
        context = {"folder": folder}
        content: dict[str, Any] = {"version": self.version}
        if self.freeze:
            content["freeze"] = [dumped_region(region, context) for region in self.freeze]
        content["edits"] = [dumped_edit(edit, context) for edit in self.edits]
        return json.dumps(content, indent=2) + "\n"

    def save(self, path: Path | str) -> None:
        """Write `to_json` to a file; an existing file is replaced in one step.

        Raises:
            EditError: the file cannot be written.
        """
        write_edit_file(path, self.to_json(Path(path).parent))


def load_edit(path: Path | str) -> EditScript:
    """Read an edit file.

    Raises:
        EditError: missing or not JSON, another version, or an edit that is not valid; the
            message names the file, the edit by number from 1, and the key.
    """
    path = Path(path)
    return parse_edit(read_edit_file(path), source=str(path), folder=path.parent)


def parse_edit(
    data: Any, *, source: str = "edit script", folder: Path | str | None = None
) -> EditScript:
    """Check the content of an edit file (parsed JSON) and return it as a script.

    Args:
        data: the object of the file.
        source: what messages call it.
        folder: where relative paths in it begin; None is the working directory.

    Raises:
        EditError: as for `load_edit`.
    """
    content = check_top(data, source)
    if is_animated(content):
        raise EditError(
            f"{source}: expected an edit that stands still, got one with keyframes; use `pcore "
            "animate`, `pcore edit apply --time`, or load_animation(...).at(time) in Python"
        )
    where = None if folder is None else Path(folder)
    edits = list(content["edits"])
    parsed: list[Edit] = []
    for number, item in enumerate(edits, start=1):
        place = f"{source}: edit {number}"
        parsed.append(parse_one(item, place=place, folder=where))
    freeze = _parse_freeze(content.get("freeze", []), source, where)
    script = EditScript(edits=cast("Any", tuple(parsed)), freeze=cast("Any", freeze))
    return script.named(source)


def check_top(data: Any, source: str) -> dict[str, Any]:
    """Check all of an edit file but its entries, and return it."""
    if not isinstance(data, dict):
        raise EditError(
            f'{source}: expected an object {{"version": {VERSION}, "edits": [...]}}, '
            f"got {shown(data)}"
        )
    content = cast("dict[str, Any]", data)
    version = content.get("version")
    if type(version) is not int or version != VERSION:
        got = "no such key" if "version" not in content else shown(version)
        raise EditError(
            f'{source}: expected "version": {VERSION}, got {got}; this pcore reads no other '
            "version of the edit file"
        )
    unknown = sorted(set(content) - set(_KEYS))
    if unknown:
        raise EditError(
            f"{source}: unknown key {quoted(unknown)}, expected only {quoted(_KEYS[:-1])} and "
            f"{quoted(_KEYS[-1:])}"
        )
    edits = content.get("edits")
    if not isinstance(edits, (list, tuple)):
        got = "no such key" if "edits" not in content else shown(edits)
        raise EditError(f'{source}: expected "edits": a list of edits, got {got}')
    return content


def parse_one(item: Any, *, place: str = "edit", folder: Path | None = None) -> Edit:
    """Check one edit (parsed JSON).

    Args:
        item: the object; an edit that was checked already is returned as it is.
        place: what messages call it.
        folder: where relative paths in it begin.

    Raises:
        EditError: it is not valid; the message names the key.
    """
    if isinstance(item, Edit):
        return item
    if not isinstance(item, Mapping):
        raise EditError(f"{place}: expected an object, got {shown(item)}")
    raw = dict(cast("Mapping[str, Any]", item))
    name = raw.get("type")
    if not isinstance(name, str) or name not in EDIT_TYPES:
        got = "no such key" if "type" not in raw else shown(name)
        raise EditError(f'{place}: key "type": expected one of {quoted(EDIT_TYPES)}, got {got}')
    kind, place = EDIT_TYPES[name], f"{place} ({name})"
    try:
        _parse_regions(raw, folder)
        return parse_entry(kind, raw, name, allowed=list(kind.model_fields), folder=folder)
    except EditError as error:
        raise EditError(f"{place}: {error}") from error


def _parse_regions(raw: dict[str, Any], folder: Path | None) -> None:
    """Replace the regions of an edit by what they mean."""
    if raw.get("region") is not None:
        try:
            raw["region"] = parse_region(raw["region"], folder)
        except EditError as error:
            raise EditError(f'key "region": {error}') from error
    if "freeze" in raw:
        raw["freeze"] = _regions(raw["freeze"], folder)


def _parse_freeze(raw: Any, source: str, folder: Path | None) -> tuple[Any, ...]:
    try:
        return _regions(raw, folder)
    except EditError as error:
        raise EditError(f"{source}: {error}") from error


def _regions(raw: Any, folder: Path | None) -> tuple[Any, ...]:
    if not isinstance(raw, (list, tuple)):
        raise EditError(f'key "freeze": expected a list of regions, got {shown(raw)}')
    regions: list[Any] = []
    for number, item in enumerate(cast("tuple[Any, ...]", tuple(raw)), start=1):
        try:
            regions.append(parse_region(item, folder))
        except EditError as error:
            raise EditError(f'key "freeze", region {number}: {error}') from error
    return tuple(regions)


def dumped_edit(edit: Edit, context: dict[str, Any] | None = None) -> dict[str, Any]:
    """The object of an edit file that describes an edit; the context may hold its "folder"."""
    return _dumped(edit, "type", context or {})


def dumped_region(region: RegionEntry, context: dict[str, Any] | None = None) -> dict[str, Any]:
    """Do the same for a region."""
    return _dumped(region, "shape", context or {})


def _dumped(entry: BaseModel, first: str, context: dict[str, Any]) -> dict[str, Any]:
    """An edit or region as JSON values: its kind first, no key that says that there is nothing."""
    plain = entry.model_dump(mode="json", exclude_none=True, context=context)
    for key in _LEFT_OUT:
        if key in plain and not getattr(entry, key):
            del plain[key]
    if plain.get("enabled") is True:
        del plain["enabled"]
    return {first: plain[first], **plain}
