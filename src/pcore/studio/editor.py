"""What a page does to an object, without any page: commands on a session and on what is shown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from torch import Tensor

from pcore.asset.asset import Asset
from pcore.editing.script import EditScript
from pcore.editing.stack import raw_edit, raw_region
from pcore.editing.state import EditState
from pcore.errors import EditError
from pcore.geometry.surfels import spacing_of
from pcore.studio.edit_forms import SLIDERS, new_edit, value_at
from pcore.studio.handle_edit import HandlePose, arriving, handle_points, moved_handle, placed


@dataclass(frozen=True, kw_only=True)
class Shown:
    """What the page shows beside the object; it never changes.

    Attributes:
        selected: number of the edit whose handles and sliders are shown; None is none.
        handle: number of its handle that has the gizmo; None is none.
        chosen: numbers of the points that are selected.
        overlay: "none", "strain", "holes" or "handles".
        still: the light stands still, where the object has one.
        compare: share of the picture, from the left, that shows the object before the edits.
    """

    selected: int | None = None
    handle: int | None = None
    chosen: frozenset[int] = frozenset()
    overlay: str = "none"
    still: bool = True
    compare: float = 0.0


class Editor:
    """An object, its edits, and what is selected; every command either does all or raises."""

    def __init__(self, asset: Asset, edit: Path | Mapping[str, Any] | None = None) -> None:
        """Begin with an edit file, or its content, or none.

        Raises:
            EditError: the edit is not valid or does not fit the points.
        """
        self.asset = asset
        self.session = asset.session(edit or EditScript(edits=()))
        self.shown = Shown()
        self.spacing = max(spacing_of(asset.points), 1e-9)
        self._dragged: EditState | None = None
        self._held_raw: dict[str, Any] | None = None
        self._kept: dict[str, Any] | None = None
        self._gesture = 0
        self._check_selected()

    @property
    def state(self) -> EditState:
        """The object as it is shown: while something is dragged, as it would be."""
        return self._dragged or self.session.state

    @property
    def dragging(self) -> bool:
        """Whether a handle is held."""
        return self._dragged is not None

    def raw(self, index: int) -> dict[str, Any]:
        """An edit as an edit file has it, keyframes at the present time."""
        return raw_edit(self.session.state.script.edits[index])

    # Edits

    def add(self, kind: str) -> None:
        """Add an edit that changes nothing yet, in the selection if there is one."""
        region = self.region() if self.shown.chosen else None
        self.session.do(new_edit(kind, self.session.state.points, region))
        self._select(len(self.session.stack.edits) - 1)

    def select(self, index: int | None) -> None:
        """Show the handles and sliders of an edit."""
        self._select(None if index is None else self.session.stack.checked(index))

    def set(self, index: int, path: str, value: Any) -> None:
        """Change a value of an edit; where it has keyframes, its key at the present time.

        Changes of one value in a row are one step to undo; `begin` starts another.
        """
        if path in self.session.tracks(index):
            self.session.key(index, path, self.session.time, value)
            return
        parent, _, last = path.rpartition("/")
        if last.isdecimal():  # One of several numbers, which an edit may leave out altogether.
            whole = [0.0, 1.0] if parent == "limits" else [0.0, 0.0, 0.0]
            whole = list(self.raw(index).get(parent, whole))
            whole[int(last)] = value
            path, value = parent, whole
        self.session.set(index, path, value, merge=f"{index} {path} {self._gesture}")

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

    # Handles

    @property
    def handles(self) -> list[HandlePose]:
        """The handles of the selected edit where they are now; none of other kinds."""
        index = self.shown.selected
        if index is None or self._kind(index) != "anchors":
            return []
        state, raw = self.state, self._held_raw or self.raw(index)
        return placed(raw, state, index)

    def place_handle(self, point: int) -> None:
        """Put a handle on a point, where it holds it; the selected edit by handles takes it."""
        index = self.shown.selected
        if index is None or self._kind(index) != "anchors":
            index = len(self.session.stack.edits)
        state = self.session.state
        near = arriving(state, index)[point].tolist()
        entry = {"near": near, "to": arriving(state, index + 1)[point].tolist()}
        if index == len(self.session.stack.edits):
            self.session.do({"type": "anchors", "handles": [entry]})
        else:
            raw = self._whole(index)
            self._refuse_second(raw, point, index)
            raw["handles"] = [*raw["handles"], entry]
            self.session.replace(index, raw)
        self._select(index, handle=len(self.raw(index)["handles"]) - 1)

    def select_handle(self, number: int | None) -> None:
        """Give a handle of the selected edit the gizmo."""
        self.shown = replace(self.shown, handle=number)

    def remove_handle(self) -> None:
        """Take the selected handle away, and its edit with the last one."""
        index, number = self._held()
        raw = self._whole(index)
        if len(raw["handles"]) == 1:
            self.remove(index)
            return
        raw["handles"] = [one for k, one in enumerate(raw["handles"]) if k != number]
        self.session.replace(index, raw)
        self.shown = replace(self.shown, handle=None)

    def drag(self, pose: HandlePose) -> None:
        """Show the selected handle somewhere else; `drop` keeps it.

        A place where space folds is shown; the last good one is remembered.
        """
        index, number = self._held()
        raw = self.raw(index)
        before = placed(raw, self.session.state, index)[number]
        moved = moved_handle(raw, number, before, pose)
        state = self.session.preview(moved, at=index)
        self._dragged, self._held_raw = state, moved
        if not len(state.folds):
            self._kept = moved

    def drop(self) -> bool:
        """Keep what was dragged, as one step; whether it stays where it was let go.

        Where that folds space it goes to the last place that did not.
        """
        dragged, kept = self._dragged, self._kept
        self.cancel()
        if dragged is None:
            return True
        index, number = self._held()
        if kept is not None:
            self._keep_handle(index, number, kept)
        return not len(dragged.folds)

    def cancel(self) -> None:
        """Put what is dragged back to where it was."""
        self._dragged = self._held_raw = self._kept = None

    # Selection

    def choose(self, points: Tensor, *, how: str = "replace") -> None:
        """Select points (N,) bool, or add or subtract them."""
        found = frozenset(points.nonzero().flatten().tolist())
        chosen = self.shown.chosen
        new = {"replace": found, "add": chosen | found, "subtract": chosen - found}[how]
        self.shown = replace(self.shown, chosen=new)

    def invert(self) -> None:
        """Select what is not selected."""
        everything = frozenset(range(len(self.asset.points)))
        self.shown = replace(self.shown, chosen=everything - self.shown.chosen)

    def region(self) -> dict[str, Any]:
        """The selection as a region of an edit file.

        Raises:
            EditError: nothing is selected.
        """
        if not self.shown.chosen:
            raise EditError("selection: expected points, got none; drag a box with Shift held")
        return {"shape": "points", "ids": sorted(self.shown.chosen)}

    def freeze(self) -> None:
        """Hold the selected points, besides what is held already."""
        held = [raw_region(entry) for entry in self.session.stack.freeze]
        self.session.freeze(*held, self.region())
        self.shown = replace(self.shown, chosen=frozenset())

    def thaw(self) -> None:
        """Let everything go that is frozen."""
        if self.session.stack.freeze:
            self.session.freeze()

    def limit(self, index: int) -> None:
        """Make an edit act on the selected points alone; on all where none is selected."""
        raw = self._whole(index)
        raw["region"] = self.region() if self.shown.chosen else None
        self.session.replace(index, {k: v for k, v in raw.items() if v is not None})

    # Time

    def at(self, time: float) -> None:
        """Go to a time of the keyframes."""
        self.session.at(time)

    def key(self, index: int, easing: str | None = None) -> None:
        """Key what an edit does, at the present time: its first number, or its handles."""
        time, raw = self.session.time, self.raw(index)
        for path, value in self._keyed(index, raw):
            self.session.key(index, path, time, value, easing=easing)

    def unkey(self, index: int) -> None:
        """Take the keys of an edit at the present time away."""
        time = self.session.time
        for path, track in self.session.tracks(index).items():
            if any(key[0] == time for key in track["keyframes"]):
                self.session.unkey(index, path, time)

    @property
    def key_times(self) -> list[float]:
        """Times of all keys, ascending."""
        edits = range(len(self.session.stack.edits))
        tracks = [track for index in edits for track in self.session.tracks(index).values()]
        return sorted({float(key[0]) for track in tracks for key in track["keyframes"]})

    def _keyed(self, index: int, raw: dict[str, Any]) -> list[tuple[str, Any]]:
        if raw["type"] == "anchors":
            return [(f"handles/{k}/to", one["to"]) for k, one in enumerate(raw["handles"])]
        first = SLIDERS[raw["type"]][0]
        return [(first.path, value_at(raw, first))]

    def _keep_handle(self, index: int, number: int, kept: dict[str, Any]) -> None:
        path, to = f"handles/{number}/to", kept["handles"][number]["to"]
        if self.session.tracks(index):
            self.set(index, path, to) if path in self.session.tracks(index) else None
        else:
            self.session.replace(index, kept)

    def _whole(self, index: int) -> dict[str, Any]:
        """An edit as an edit file has it, with all its keyframes."""
        return raw_edit(self.session.stack.edits[self.session.stack.checked(index)])

    def _kind(self, index: int) -> str:
        return str(self._whole(index)["type"])

    def _held(self) -> tuple[int, int]:
        index, number = self.shown.selected, self.shown.handle
        if index is None or number is None or self._kind(index) != "anchors":
            raise EditError("handle: expected a selected handle, got none; click one")
        return index, number

    def _refuse_second(self, raw: dict[str, Any], point: int, index: int) -> None:
        if point in handle_points(raw, arriving(self.session.state, index)):
            raise EditError("handle: there is one at this very place already")

    def _select(self, index: int | None, handle: int | None = None) -> None:
        self.cancel()
        self._gesture += 1
        self.shown = replace(self.shown, selected=index, handle=handle)

    def _check_selected(self) -> None:
        """After a command: the selected edit may be gone, or have fewer handles."""
        self.cancel()
        self._gesture += 1
        count, index = len(self.session.stack.edits), self.shown.selected
        index = count - 1 if index is None or index >= count else index
        handle = self.shown.handle if index == self.shown.selected else None
        self.shown = replace(self.shown, selected=index if count else None)
        if handle is not None and handle >= len(self.handles):
            handle = None
        self.shown = replace(self.shown, handle=handle)
