"""The edits of a session as one value: each stands still or has keyframes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from pcore.editing.animation import Animation
from pcore.editing.edits import Edit
from pcore.editing.keyframes import at_time, is_animated
from pcore.editing.reading import parse_region
from pcore.editing.regions import RegionEntry
from pcore.editing.script import EditScript, dumped_edit, dumped_region, parse_one
from pcore.errors import EditError


@dataclass(frozen=True, kw_only=True)
class Keyed:
    """An edit or a region with keyframes.

    Attributes:
        raw: its object in an edit file, with tracks in place of numbers; paths are absolute.
    """

    raw: Mapping[str, Any]


EditEntry = Edit | Keyed
RegionLike = RegionEntry | Keyed


@dataclass(frozen=True, kw_only=True)
class Stack:
    """Edits in their order, and what is frozen.

    Attributes:
        edits: from the first to the last.
        freeze: regions that never move.
        source: what messages call it, such as its file.
    """

    edits: tuple[EditEntry, ...] = ()
    freeze: tuple[RegionLike, ...] = ()
    source: str = "edit script"

    @classmethod
    def of(cls, edits: EditScript | Animation) -> Stack:
        """Take over what was read from an edit file."""
        if isinstance(edits, EditScript):
            return cls(edits=edits.edits, freeze=edits.freeze, source=edits.source)
        content = edits.content
        return cls(
            edits=tuple(map(edit_entry, content["edits"])),
            freeze=tuple(map(region_entry, content.get("freeze", []))),
            source=edits.source,
        )

    @property
    def animated(self) -> bool:
        """Whether anything has keyframes."""
        return any(isinstance(entry, Keyed) for entry in (*self.edits, *self.freeze))

    @property
    def content(self) -> dict[str, Any]:
        """The object of an edit file that means the same; paths are absolute."""
        content: dict[str, Any] = {"version": 2}
        if self.freeze:
            content["freeze"] = [raw_region(entry) for entry in self.freeze]
        return {**content, "edits": [raw_edit(entry) for entry in self.edits]}

    @property
    def animation(self) -> Animation:
        """The same for every time.

        Raises:
            EditError: an edit is not valid at one of its keys.
        """
        return Animation(self.content, source=self.source)

    def at(self, time: float) -> EditScript:
        """The edits at a time.

        Raises:
            EditError: one of them is not valid then.
        """
        edits = [
            parse_one(at_time(entry.raw, time), place=f"edit {number} at time {time:g}")
            if isinstance(entry, Keyed)
            else entry
            for number, entry in enumerate(self.edits, start=1)
        ]
        freeze = [
            parse_region(at_time(entry.raw, time), None) if isinstance(entry, Keyed) else entry
            for entry in self.freeze
        ]
        made = EditScript(edits=cast("Any", tuple(edits)), freeze=cast("Any", tuple(freeze)))
        return made.named(self.source)

    def save(self, path: Path | str) -> None:
        """Write an edit file that means the same; an existing file is replaced in one step.

        Raises:
            EditError: the file cannot be written, or an edit is not valid at one of its keys.
        """
        (self.animation if self.animated else self.at(0.0)).save(path)

    def from_source(self, source: str) -> Stack:
        """Return the same under another name for messages."""
        return replace(self, source=source)

    def checked(self, index: int) -> int:
        """Return the number of an edit that there is, from 0.

        Raises:
            EditError: there is no such edit.
        """
        if not 0 <= index < len(self.edits):
            count = len(self.edits)
            wanted = (
                f"the number of an edit, 0 to {count - 1}" if count else "an edit, there is none"
            )
            raise EditError(f"session: expected {wanted}, got {index}")
        return index

    def changed(self, index: int, *entries: EditEntry) -> Stack:
        """Return the same with one edit replaced by others, or by none."""
        at = self.checked(index)
        return replace(self, edits=(*self.edits[:at], *entries, *self.edits[at + 1 :]))

    def rewritten(self, index: int, change: Callable[[dict[str, Any]], object]) -> Stack:
        """Return the same with one edit's object in an edit file changed in place.

        Raises:
            EditError: it is then no valid edit.
        """
        raw = raw_edit(self.edits[self.checked(index)])
        change(raw)
        return self.changed(index, edit_entry(raw))


def edit_entry(edit: Edit | Mapping[str, Any] | Keyed) -> EditEntry:
    """Check an edit, or the object of an edit file that describes one, with keyframes or without.

    Raises:
        EditError: it is not valid; of one with keyframes that is found out at a time.
    """
    if isinstance(edit, (Edit, Keyed)):
        return edit
    raw = _plain(edit)
    return Keyed(raw=raw) if is_animated(raw) else parse_one(raw)


def region_entry(region: RegionLike | Mapping[str, Any]) -> RegionLike:
    """Do the same for a region."""
    if isinstance(region, (RegionEntry, Keyed)):
        return region
    raw = _plain(region)
    return Keyed(raw=raw) if is_animated(raw) else parse_region(raw, None)


def raw_edit(entry: EditEntry) -> dict[str, Any]:
    """The object of an edit file that describes an edit; a copy."""
    return _plain(entry.raw) if isinstance(entry, Keyed) else dumped_edit(entry)


def raw_region(entry: RegionLike) -> dict[str, Any]:
    """Do the same for a region."""
    return _plain(entry.raw) if isinstance(entry, Keyed) else dumped_region(entry)


def _plain(value: Any) -> Any:
    """A copy of parsed JSON; entries that are checked already stay as they are."""
    if isinstance(value, Mapping):
        items = cast("Mapping[str, Any]", value)
        return {key: _plain(item) for key, item in items.items()}
    if isinstance(value, (list, tuple)):
        if set(map(type, cast("list[Any]", value))) == {float}:  # Most are places, by the thousand.
            return list(cast("list[float]", value))
        return [_plain(item) for item in cast("list[Any]", value)]
    return value
