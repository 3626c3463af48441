"""An object, its stack of edits and what is shown of it; `Editor` adds handles and selections."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.standing import standing_of
from pcore.editing.regions import FALLOFF
from pcore.editing.script import EditScript
from pcore.editing.selection import Selector
from pcore.editing.session import EditSession
from pcore.editing.stack import raw_edit
from pcore.editing.state import EditState
from pcore.editing.tracks import put_at, set_value
from pcore.editing.widening import widened
from pcore.errors import EditError, PcoreError
from pcore.geometry.point_cloud import extent_of, size_of
from pcore.geometry.surfels import spacing_of
from pcore.studio.edit_forms import new_edit
from pcore.studio.edit_handles import ONE, handles_or_error
from pcore.studio.shown import MANY, Shown


class StackEditor:
    """An object and its edits; every command either does all or raises."""

    def __init__(self, asset: Asset, edit: Path | Mapping[str, Any] | None = None) -> None:
        """Begin with an edit file, or its content, or none.

        Raises:
            EditError: the edit is not valid or does not fit the points.
        """
        self.asset = asset
        self.session = asset.session(edit or EditScript(edits=()))
        self.shown = Shown(moving="splats" if len(asset.points) < MANY else "points")
        self.standing = standing_of(asset)
        self.body = self.standing.body(asset.points)
        self.size = size_of(asset.points[self.body])
        self.spacing = max(spacing_of(asset.points), 1e-9)
        self.selector = Selector(rest=asset.points)
        self._dragged: EditState | None = None
        self._passing: tuple[int, EditState] | None = None
        self._held_raw: dict[str, Any] | None = None
        self._kept: dict[str, Any] | None = None
        self._sliding: tuple[int, str] | None = None
        self._good: Any = None
        self._way: tuple[Any, Any] | None = None
        self._gesture = 0
        self._folded: tuple[int, int, dict[str, Any]] | None = None
        self._check_selected()

    def resume(self, session: EditSession) -> None:
        """Go on with another session of the same object."""
        self.session = session
        self._check_selected()

    @property
    def state(self) -> EditState:
        """The object as it is shown: while something is dragged, as it would be."""
        return self._dragged or self._present

    def refine(self) -> None:
        """Show the exact state of the present time from now on."""
        self._passing = None

    @property
    def _present(self) -> EditState:
        """The state of the session; while its time goes by, a quick one with the same points."""
        passing, number = self._passing, self.session.history.present.number
        return passing[1] if passing and passing[0] == number else self.session.state

    @property
    def dragging(self) -> bool:
        """Whether a handle is held."""
        return self._dragged is not None

    def raw(self, index: int) -> dict[str, Any]:
        """An edit as an edit file has it, keyframes at the present time."""
        return raw_edit(self._present.script.edits[index])

    def add(self, kind: str) -> None:
        """Add an edit that changes nothing yet, in the selection if there is one.

        Without one it acts on the object, not on what stands around it, a part on a ball in it.
        """
        points = self.session.state.points[self.body]
        region = None if kind == "part" else self._bounds(points)
        if self.shown.chosen:
            region, points = self.region(), self.session.state.points
        raw = new_edit(kind, points, region)
        if "region" in raw:
            raw["region"] = self._soft(raw["region"])
        self.session.do(raw)
        self._select(len(self.session.stack.edits) - 1)

    def select(self, index: int | None) -> None:
        """Show the handles and sliders of an edit."""
        self._select(None if index is None else self.session.stack.checked(index))

    def set(self, index: int, path: str, value: Any) -> None:
        """Change a value of an edit; where it has keyframes, its key at the present time.

        Changes of one value in a row are one step to undo; `begin` starts another.
        """
        whole, merge = self._whole(index), f"{index} {path} {self._gesture}"
        parent, _, last = path.rpartition("/")
        if last.isdecimal() and parent not in whole:  # One of several, which are left out.
            whole[parent] = [0.0, 1.0] if parent == "limits" else [0.0, 0.0, 0.0]
        put_at(whole, path, self.session.time, value)
        self.session.replace(index, whole, merge=merge)

    def slide(self, index: int, path: str, value: Any) -> None:
        """Show the selected edit with another value; `settle` keeps it.

        A value with which space folds is shown; the last good one is remembered.
        """
        if self._sliding != (index, path):
            self.settle()
        raw = self.raw(self.session.stack.checked(index))
        set_value(raw, *self._whole_value(index, path, value))
        state = self.session.preview(raw, at=index, frames="quick")
        self._dragged, self._held_raw, self._sliding = state, raw, (index, path)
        if not len(state.folds):
            self._good = value
        self._came(None, value)

    def settle(self) -> bool:
        """Keep the value that `slide` shows, as one step; whether it stays, as `drop`."""
        sliding, good, shown, folded = self._sliding, self._good, self._dragged, self._held_raw
        if sliding is None or shown is None:
            return True
        self.cancel()
        self.begin()
        if good is not None:
            self.set(*sliding, good)
        return not self._refuses(shown, sliding[0], folded)

    def _refuses(self, shown: EditState, index: int, raw: dict[str, Any] | None) -> bool:
        """Whether a state folds; `widen` can then do what led to it."""
        if not len(shown.folds):
            return False
        if raw is not None and not self.session.tracks(index):
            self._folded = self.session.history.present.number, index, raw
        return True

    @property
    def widens(self) -> bool:
        """Whether the last thing done folded space and there are seams to widen against it."""
        folded = self._folded
        if folded is None or folded[0] != self.session.history.present.number:
            return False
        raw = folded[2]
        own = raw["type"] == "anchors" or raw.get("region") or raw.get("freeze")
        return bool(own or self.session.stack.freeze)

    def widen(self) -> float:
        """Do what folded last with seams that are wide enough, as one step.

        Returns:
            Their falloff, world units.

        Raises:
            EditError: nothing folded, or no width helps.
        """
        if self._folded is None or not self.widens:
            raise EditError("falloff: expected a drag that folds, got none since the last step")
        _, index, raw = self._folded
        self._folded = None
        found = widened(self.session, raw, index)
        self.session.replace(index, found.edit, freeze=found.freeze)
        return found.falloff

    @property
    def sliding(self) -> bool:
        """Whether a value is shown that is not kept yet."""
        return self._sliding is not None

    def rename(self, index: int, name: str | None) -> None:
        """Name an edit; what is typed in a row is one step to undo, as of `set`."""
        self.session.rename(index, name, merge=f"{index} name {self._gesture}")

    def begin(self) -> None:
        """Make the next change of a value a step of its own."""
        self._gesture += 1

    def remove(self, index: int) -> None:
        """Take an edit out."""
        self.session.remove(index)
        self._check_selected()

    def move(self, index: int, by: int) -> None:
        """Put an edit earlier (by -1) or later (by 1); nothing at the ends."""
        to = index + by
        if 0 <= to < len(self.session.stack.edits):
            self.session.move(index, to)
            self._select(to)

    def duplicate(self, index: int) -> None:
        """Put a copy of an edit behind it."""
        self.session.duplicate(index)
        self._select(index + 1)

    def undo(self) -> None:
        """Go back to the state before the last command."""
        self.session.undo()
        self._check_selected()

    def redo(self) -> None:
        """Do again what was undone last."""
        self.session.redo()
        self._check_selected()

    def cancel(self) -> None:
        """Put what is dragged back to where it was."""
        self._dragged = self._held_raw = self._kept = self._sliding = self._good = None
        self._way = None

    def _came(self, start: Any, value: Any) -> None:
        """Remember how far what is dragged is beyond the last place where nothing folds."""
        folds = self._dragged is not None and len(self._dragged.folds) > 0
        good = start if self._way is None else self._way[0]
        self._way = (good if folds else value), value

    def region(self) -> dict[str, Any]:
        """The selection as a region of an edit file.

        Raises:
            EditError: nothing is selected.
        """
        if not self.shown.chosen:
            raise EditError("selection: expected points, got none; draw one with Shift held")
        return self._soft({"shape": "points", "ids": sorted(self.shown.chosen)})

    def _soft(self, region: dict[str, Any]) -> dict[str, Any]:
        """A region whose soft edges go by the object's size, where they have no width."""
        if "falloff" in region or bool(self.body.all()):
            return region
        return {**region, "falloff": FALLOFF * self.size}

    def _bounds(self, points: Tensor) -> dict[str, Any] | None:
        """Where the object's points (N, 3) are now, as a region; None where it has all."""
        if bool(self.body.all()):
            return None
        lower, upper = (corner.double().tolist() for corner in extent_of(points))
        return {"shape": "box", "lower": lower, "upper": upper}

    def _whole(self, index: int) -> dict[str, Any]:
        """An edit as an edit file has it, with all its keyframes."""
        return raw_edit(self.session.stack.edits[self.session.stack.checked(index)])

    def _whole_value(self, index: int, path: str, value: Any) -> tuple[str, Any]:
        """Path and value to write; of one of several numbers, which an edit may lack, all."""
        parent, _, last = path.rpartition("/")
        if not last.isdecimal():
            return path, value
        whole = [0.0, 1.0] if parent == "limits" else [0.0, 0.0, 0.0]
        whole = self.raw(index).get(parent, whole)
        if not isinstance(whole, list) or int(last) >= len(whole):
            raise EditError(f'"{path}": expected a place within the edit, got none')
        whole = list(cast("list[Any]", whole))
        whole[int(last)] = value
        return parent, whole

    def _kind(self, index: int) -> str:
        return str(self._whole(index)["type"])

    def _select(self, index: int | None, handle: int | None = None) -> None:
        self.cancel()
        self._gesture += 1
        if handle is None and index is not None and self._kind(index) in ONE:
            handle = 0
        self.shown = replace(self.shown, selected=index, handle=handle)

    def _check_selected(self) -> None:
        """After a command: the selected edit may be gone, or have fewer handles."""
        count, index = len(self.session.stack.edits), self.shown.selected
        gone = index is None or index >= count
        index = count - 1 if gone else index
        handle = None if gone else self.shown.handle
        selected = index if count else None
        if handle is not None and selected is not None:
            found = handles_or_error(self.raw(selected), self.session.state, selected)
            if isinstance(found, PcoreError) or handle >= len(found):
                handle = None
        self._select(selected, handle=handle)
