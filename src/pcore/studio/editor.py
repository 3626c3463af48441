"""What a page does to an object, without any page: handles, selections, keys."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from pcore.editing.dragging import Mirror
from pcore.editing.stack import raw_region
from pcore.errors import EditError
from pcore.studio.edit_forms import AXES, SLIDERS, value_at
from pcore.studio.handle_edit import (
    HandlePose,
    arriving,
    handle_points,
    mirrored,
    moved_handle,
    placed,
)
from pcore.studio.stack_editor import StackEditor

_UNEVEN = 4.0
"""Spacings."""


class Editor(StackEditor):
    """A `StackEditor` with handles that are dragged, points that are selected, and time."""

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
        before, after = arriving(state, index), arriving(state, index + 1)
        fresh = index == len(self.session.stack.edits)
        raw = {"type": "anchors", "handles": []} if fresh else self._whole(index)
        self._refuse_second(raw, point, index)
        number = len(raw["handles"])
        entries = [
            {"near": before[one].tolist(), "to": after[one].tolist()}
            for one in self._pair(point, before)
        ]
        raw["handles"] = [*raw["handles"], *entries]
        self.session.do(raw) if fresh else self.session.replace(index, raw)
        self._select(index, handle=number)

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
        if self._mirror is not None:
            moved = mirrored(moved, number, self._mirror, self._beside)
        state = self.session.preview(moved, at=index, frames="quick")
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

    def grow(self) -> None:
        """Select the neighbours of what is selected, too."""
        self.choose(self.selector.grow(self._mask))

    def shrink(self) -> None:
        """Take the rim of the selection away."""
        self.choose(self.selector.shrink(self._mask))

    @property
    def _mask(self) -> Tensor:
        """(N,) bool, which points are selected."""
        mask = torch.zeros(len(self.asset.points), dtype=torch.bool)
        mask[sorted(self.shown.chosen)] = True
        return mask

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
            names = ("to", "rotation")
            return [
                (f"handles/{k}/{name}", one[name])
                for k, one in enumerate(raw["handles"])
                for name in names
                if one.get(name) is not None
            ]
        first = SLIDERS[raw["type"]][0]
        return [(first.path, value_at(raw, first))]

    def _keep_handle(self, index: int, number: int, kept: dict[str, Any]) -> None:
        tracks = self.session.tracks(index)
        if not tracks:
            self.session.replace(index, kept)
        for name in ("to", "rotation"):
            path = f"handles/{number}/{name}"
            if path in tracks:
                self.set(index, path, kept["handles"][number][name])

    def _held(self) -> tuple[int, int]:
        index, number = self.shown.selected, self.shown.handle
        if index is None or number is None or self._kind(index) != "anchors":
            raise EditError("handle: expected a selected handle, got none; click one")
        return index, number

    @property
    def _mirror(self) -> Mirror | None:
        """The plane across which handles move in pairs; None where they do not."""
        if self.shown.mirror == "off":
            return None
        return Mirror.of(self.asset.points, AXES.index(self.shown.mirror))

    @property
    def _beside(self) -> float:
        """How far from its image a handle may be: objects are not as even as planes."""
        return _UNEVEN * self.spacing

    def _pair(self, point: int, places: Tensor) -> list[int]:
        """A point and, with a mirror, the one at its image; alone on the plane or without one."""
        mirror = self._mirror
        if mirror is None or abs(mirror.distance(places[point])) <= self._beside:
            return [point]
        image = torch.tensor(mirror.image(places[point]), dtype=places.dtype)
        away = (places - image).norm(dim=1)
        other = int(away.argmin())
        return [point, other] if float(away[other]) <= self._beside else [point]

    def _refuse_second(self, raw: dict[str, Any], point: int, index: int) -> None:
        if point in handle_points(raw, arriving(self.session.state, index)):
            raise EditError("handle: there is one at this very place already")
