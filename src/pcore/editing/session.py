"""Editing as a sequence of commands: do, undo, redo, preview, freeze, save, load."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from pcore.editing.animation import load_animation
from pcore.editing.edits import Edit
from pcore.editing.regions import RegionEntry
from pcore.editing.stack import EditEntry, Keyed, Stack, edit_entry, raw_edit, region_entry
from pcore.editing.state import EditState
from pcore.editing.tracks import Track, remove_key, set_key, set_value, tracks_of
from pcore.editing.undoing import Undoable

EditLike = Edit | Keyed | Mapping[str, Any]
"""An edit, or the object of an edit file that describes one, with keyframes or without."""


class EditSession(Undoable):
    """The points of an object and what was done to them.

    Every command either makes a new state or raises and changes nothing. Only the edits from the
    changed one on are bound again. Edits are numbered from 0 here, as in Python.
    """

    def do(self, edit: EditLike, *, merge: str | None = None) -> EditState:
        """Add an edit after those there are; what was undone before is forgotten.

        Args:
            edit: the edit.
            merge: a key; commands with the same one that follow each other are one to `undo`, and
                the last of them counts. For what is dragged.

        Raises:
            EditError: it is not valid, does not fit the points, or folds space.
        """
        entry = edit_entry(edit)
        base = self._history.base(merge).stack
        stack = replace(base, edits=(*base.edits, entry))
        return self._do(stack, f"do {_kind(entry)}", merge)

    def replace(
        self,
        index: int,
        edit: EditLike,
        *,
        merge: str | None = None,
        freeze: tuple[RegionEntry, ...] | None = None,
    ) -> EditState:
        """Put another edit in the place of one; arguments and errors as `do`.

        Args:
            index: of the one.
            edit: the other one.
            merge: as `do`.
            freeze: what is frozen from now on, in the same step; None leaves that as it is.
        """
        entry = edit_entry(edit)
        stack = self.stack.changed(index, entry)
        stack = stack if freeze is None else replace(stack, freeze=freeze)
        return self._do(stack, f"change {_kind(entry)}", merge)

    def set(self, index: int, path: str, value: Any, *, merge: str | None = None) -> EditState:
        """Change one value of an edit.

        Args:
            index: of the edit.
            path: of the value in the edit file, such as "amount" or "handles/0/to".
            value: number, list or text.
            merge: as `do`.

        Raises:
            EditError: as `do`; or there is no such place, or it has keyframes.
        """
        return self._rewrite(index, lambda raw: set_value(raw, path, value), f"set {path}", merge)

    def remove(self, index: int) -> EditState:
        """Take an edit out; errors as `do`, since what follows may not fit any more."""
        return self._do(self.stack.changed(index), f"remove {self._name(index)}")

    def move(self, index: int, to: int) -> EditState:
        """Put an edit in another place, where it then has the number `to`; errors as `do`."""
        stack = self.stack
        entry, label = stack.edits[stack.checked(index)], f"move {self._name(index)}"
        rest = list(stack.changed(index).edits)
        rest.insert(stack.checked(to), entry)
        return self._do(replace(stack, edits=tuple(rest)), label)

    def mute(self, index: int, muted: bool = True) -> EditState:
        """Leave an edit out but keep it in the list, or let it act again; errors as `do`."""
        label = f"{'mute' if muted else 'unmute'} {self._name(index)}"
        return self._rewrite(index, lambda raw: raw.update(enabled=not muted), label)

    def rename(self, index: int, name: str | None, *, merge: str | None = None) -> EditState:
        """Give an edit a name, or none; `merge` as `do`.

        Raises:
            EditError: an empty name or a very long one.
        """
        return self._rewrite(index, lambda raw: raw.update(name=name), "rename", merge)

    def duplicate(self, index: int) -> EditState:
        """Put a copy of an edit behind it; errors as `do`."""
        entry = self.stack.edits[self.stack.checked(index)]
        stack = self.stack.changed(index, entry, entry)
        return self._do(stack, f"duplicate {self._name(index)}")

    def key(
        self, index: int, path: str, time: float, value: Any, *, easing: str | None = None
    ) -> EditState:
        """Give a value of an edit a key at a time; one that is there at that time is replaced.

        Args:
            index: of the edit.
            path: as `set`.
            time: of the key.
            value: number or list of numbers.
            easing: of all keys of the value; None leaves it as it is.

        Raises:
            EditError: as `set`.
        """
        return self._rewrite(
            index, lambda raw: set_key(raw, path, time, value, easing), f"key {path}"
        )

    def unkey(self, index: int, path: str, time: float) -> EditState:
        """Take a key away; with the last one the value stands still again.

        Raises:
            EditError: there is no such key, or as `do`.
        """
        return self._rewrite(index, lambda raw: remove_key(raw, path, time), f"unkey {path}")

    def tracks(self, index: int) -> dict[str, Track]:
        """All values with keyframes of an edit, by their paths."""
        return tracks_of(raw_edit(self.stack.edits[self.stack.checked(index)]))

    def preview(
        self,
        edit: EditLike,
        at: int | None = None,
        *,
        folds: Literal["plain", "refuse"] = "plain",
        frames: Literal["exact", "quick"] = "exact",
    ) -> EditState:
        """Return the state that `do` or `replace` would lead to, and stay where we are.

        For what is dragged: the points are those of the command, to the last bit.

        Args:
            edit: the edit.
            at: the number of the edit that it takes the place of; None adds it at the end.
            folds: "plain": folds are accepted, no Jacobian is computed, and the state says where
                they are (`EditState.folds`) and with which rays it can be drawn (`EditState.rays`);
                "refuse": they are refused, as the command does.
            frames: "quick": how space moves around points is fitted in one step to where they go,
                of displacements, of cages, and of meshes where they fold over: points are the same,
                and it takes a fiftieth of the time. Other edits have the exact frames at once.

        Raises:
            EditError: as the command, but for folds.
        """
        entry, stack = edit_entry(edit), self.stack
        if at is None:
            longer = replace(stack, edits=(*stack.edits, entry))
        else:
            longer = stack.changed(at, entry)
        return self._bound(longer, self.state, check=folds == "refuse", quick=frames == "quick")

    def warm(self, edit: EditLike, at: int | None = None) -> None:
        """Prepare a preview, so that the first one of a drag is as quick as the others.

        Anchors at new handles, and the binding of a cage, are kept then.

        Raises:
            EditError: as `preview`.
        """
        _ = self.preview(edit, at).bound.linear

    def freeze(self, *regions: RegionEntry | Mapping[str, Any]) -> EditState:
        """Hold regions in the canonical space through all edits, done ones too; none lets all go.

        Raises:
            EditError: a region is not valid or holds no point, or an edit folds with it.
        """
        return self._do(replace(self.stack, freeze=tuple(map(region_entry, regions))), "freeze")

    def save(self, path: Path | str) -> None:
        """Write the present edits as an edit file, which gives the same points on the same run.

        Raises:
            EditError: the file cannot be written.
        """
        self.stack.save(path)

    def load(self, path: Path | str, *, time: float | None = None) -> EditState:
        """Replace the present edits by those of an edit file; `undo` brings them back.

        Args:
            path: the file.
            time: of a file with keyframes, which then stands still: `save` writes its values at
                that time. None keeps the keyframes.

        Raises:
            EditError: the file is not valid or does not fit the points.
        """
        animation = load_animation(path)
        stack = Stack.of(animation if time is None else animation.at(time))
        # Its files may have changed, so nothing that is bound already is taken over.
        state = self._bound(stack, None, said=f"{path}: ")
        return self._keep(stack, state, f"load {Path(path).name}", None)

    def _name(self, index: int) -> str:
        return _kind(self.stack.edits[self.stack.checked(index)])

    def _rewrite(
        self,
        index: int,
        change: Callable[[dict[str, Any]], object],
        label: str,
        merge: str | None = None,
    ) -> EditState:
        return self._do(self.stack.rewritten(index, change), label, merge)


def _kind(entry: EditEntry) -> str:
    raw: Any = entry.raw.get("type") if isinstance(entry, Keyed) else getattr(entry, "type", "")
    return str(raw)
