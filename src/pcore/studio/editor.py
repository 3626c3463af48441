"""What a page does to an object, without any page: handles, cages, keys."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from pcore.editing.anchors_edit import AnchorsEdit
from pcore.editing.dragging import Mirror
from pcore.editing.tracks import put_at, remove_key, tracks_of
from pcore.errors import EditError, PcoreError
from pcore.studio.cage_handles import loose_box, write_cage
from pcore.studio.edit_forms import AXES
from pcore.studio.edit_handles import (
    handles_of_edit,
    handles_or_error,
    with_handle,
    without_handle,
)
from pcore.studio.handle_edit import arriving, handle_points
from pcore.studio.handle_pose import (
    STILL,
    HandlePose,
    degrees_of,
    turn_of_degrees,
    way_between,
)
from pcore.studio.keying import differences, has_keys, keyed_values
from pcore.studio.selection_editor import SelectionEditor

_UNEVEN = 4.0
"""Spacings."""
_FINE = 1e-3
"""Places that pages tell apart, in sizes of the object."""
_DEGREE = 0.01


class Editor(SelectionEditor):
    """A `SelectionEditor` with handles that are dragged, cages, and time."""

    @property
    def handles(self) -> list[HandlePose]:
        """The handles of the selected edit where they are now; none of kinds without, or `lost`."""
        found = self._found
        return [] if isinstance(found, PcoreError) else found

    @property
    def lost(self) -> PcoreError | None:
        """Why the selected edit shows no handles, where a file of it is gone."""
        found = self._found
        return found if isinstance(found, PcoreError) else None

    @property
    def _found(self) -> list[HandlePose] | PcoreError:
        index, raw = self.shown.selected, self.present
        return [] if index is None or raw is None else handles_or_error(raw, self.state, index)

    @property
    def present(self) -> dict[str, Any] | None:
        """The selected edit as it is shown, keyframes at the present time; None without one."""
        index = self.shown.selected
        return None if index is None else self._held_raw or self.raw(index)

    def place_handle(self, point: int, *, pin: bool = False) -> None:
        """Put a handle on a point; the selected edit by handles takes it.

        Args:
            point: its number.
            pin: it holds the place where the point was before this edit, and another handle
                stays selected; otherwise it holds the point where it is now, and is selected.
        """
        index = self.shown.selected
        if index is None or self._kind(index) != "anchors":
            index = len(self.session.stack.edits)
        state = self.session.state
        before, after = arriving(state, index).points, arriving(state, index + 1).points
        fresh = index == len(self.session.stack.edits)
        raw = self._new_handles() if fresh else self._whole(index)
        self._refuse_useless(raw, point, index)
        number = len(raw["handles"])
        to = before if pin else after
        entries = [
            {"near": before[one].tolist(), "to": to[one].tolist()}
            for one in self._pair(point, before)
        ]
        raw["handles"] = [*raw["handles"], *entries]
        self.session.do(raw) if fresh else self.session.replace(index, raw)
        self._select(index, handle=self.shown.handle if pin and not fresh else number)

    def _new_handles(self) -> dict[str, Any]:
        """An edit without handles yet, which reach over the object, not over what is around it."""
        raw: dict[str, Any] = {"type": "anchors", "handles": []}
        if not bool(self.body.all()):
            raw["reach"] = AnchorsEdit.reach_of(None, self.size)
        return raw

    def select_handle(self, number: int | None) -> None:
        """Give a handle of the selected edit the gizmo."""
        self.shown = replace(self.shown, handle=number)

    def remove_handle(self) -> None:
        """Take the selected handle away, and its edit with the last one; vertices go back."""
        index, number = self._held()
        raw = without_handle(self._whole(index), number)
        if raw is None:
            self.remove(index)
            return
        self.session.replace(index, raw)
        self.shown = replace(self.shown, handle=None)

    def drag(self, pose: HandlePose) -> None:
        """Show the selected handle somewhere else; `drop` keeps it.

        A place where space folds is shown; the last good one is remembered.
        """
        self.settle()
        index, number = self._held()
        raw = self.raw(index)
        before = handles_of_edit(raw, self.session.state, index)[number]
        mirror = None if self._mirror is None else (self._mirror, self._beside)
        wanted = self._locked(before, pose)
        moved = with_handle(raw, number, before, wanted, self.session.state, index, mirror)
        state = self.session.preview(moved, at=index, frames="quick")
        self._dragged, self._held_raw = state, moved
        if not len(state.folds):
            self._kept = moved
        self._came(before, wanted)

    @property
    def back(self) -> str:
        """By how much what is dragged has to go back until nothing folds; empty without a fold."""
        if self._way is None or not len(self.state.folds):
            return ""
        good, now = self._way
        if isinstance(now, HandlePose):
            return way_between(good, now)
        return "all the way" if good is None else f"{abs(now - good):.3g}"

    def put(self, *, place: Any = None, degrees: Any = None) -> bool:
        """Put the selected handle at a place (3,), or turn it by `degrees_of`, as one step.

        Numbers that are those of now but for the rounding of a page change nothing.

        Returns:
            Whether it is there: as `drop`.
        """
        _, number = self._held()
        now = self.handles[number]
        if place is not None:
            fine = 0.51 * 10.0**-self.digits
            x, y, z = (
                b if abs(a - b) <= fine else a for a, b in zip(place, now.place, strict=True)
            )
            now = replace(now, place=(x, y, z))
        if degrees is not None:
            old = degrees_of(now.turn)
            kept = [b if abs(a - b) <= _DEGREE else a for a, b in zip(degrees, old, strict=True)]
            now = replace(now, turn=turn_of_degrees(kept))
        self.drag(now)
        return self.drop()

    @property
    def digits(self) -> int:
        """Decimals that pages show of places, world units."""
        return math.ceil(-math.log10(max(_FINE * self.size, 1e-12)))

    def drop(self) -> bool:
        """Keep what was dragged, as one step; whether it stays where it was let go.

        Where that folds space it goes to the last place that did not.
        """
        dragged, kept = self._dragged, self._kept
        folded = self._held_raw
        self.cancel()
        if dragged is None:
            return True
        index, _ = self._held()
        if kept is not None and kept != self.raw(index):
            self._keep(index, kept)
        return not self._refuses(dragged, index, folded)

    def add_cage(self, file: Path, *, cells: int) -> None:
        """Add a box around the selected points, or the object, that changes nothing yet.

        Args:
            file: where its mesh is written, .ply.
            cells: of the box along its longest side.

        Raises:
            EditError: points without an extent.
            InputError: the file cannot be written.
        """
        points = self.session.state.points.detach().cpu()
        held = points[self.mask] if self.shown.chosen else points[self.body]
        region = self.region() if self.shown.chosen else self._bounds(held)
        vertices = write_cage(file, loose_box(held, cells))
        raw = {"type": "cage", "before": str(file.absolute()), "after": vertices}
        self.session.do(raw if region is None else {**raw, "region": region})
        self._select(len(self.session.stack.edits) - 1)

    # Time

    def at(self, time: float) -> None:
        """Go to a time of the keyframes: its points at once, all else by `refine`."""
        state = self.session.at(time, frames="quick")
        self._passing = (self.session.history.present.number, state)

    def key(self, index: int, easing: str | None = None) -> None:
        """Key all numbers and handles of an edit at the present time, as one step."""
        whole, time = self._whole(index), self.session.time
        size = arriving(self.session.state, index).size
        for path, value in keyed_values(self.raw(index), size):
            put_at(whole, path, time, value, key=True, easing=easing)
        self.session.replace(index, whole)

    def unkey(self, index: int) -> None:
        """Take the keys of an edit at the present time away, as one step."""
        whole, time = self._whole(index), self.session.time
        for path, track in tracks_of(whole).items():
            if any(key[0] == time for key in track["keyframes"]):
                remove_key(whole, path, time)
        self.session.replace(index, whole)

    @property
    def key_times(self) -> list[float]:
        """Times of all keys, ascending."""
        edits = range(len(self.session.stack.edits))
        tracks = [track for index in edits for track in self.session.tracks(index).values()]
        return sorted({float(key[0]) for track in tracks for key in track["keyframes"]})

    def _keep(self, index: int, kept: dict[str, Any]) -> None:
        """Put what was dragged in the place of an edit; where it has keys, it sets them."""
        whole, time, old = self._whole(index), self.session.time, self.raw(index)
        times = {float(key[0]) for one in tracks_of(whole).values() for key in one["keyframes"]}
        if not times:
            self.session.replace(index, kept)
            return
        for path, before, value in differences(old, kept):
            before = list(STILL) if before is None and path.endswith("/rotation") else before
            # What had no keys stays as it was at the times of the others; texts have none.
            alike = type(before) is type(value) and not isinstance(value, str)
            for other in times - {time} if alike and not has_keys(whole, path) else ():
                put_at(whole, path, other, before, key=True)
            put_at(whole, path, time, value, key=alike)
        self.session.replace(index, whole)

    def _locked(self, before: HandlePose, pose: HandlePose) -> HandlePose:
        """A pose whose place differs from the one before along the locked axis alone."""
        if self.shown.lock == "off":
            return pose
        free = AXES.index(self.shown.lock)
        x, y, z = (pose.place[k] if k == free else before.place[k] for k in range(3))
        return replace(pose, place=(x, y, z))

    def _held(self) -> tuple[int, int]:
        index, number = self.shown.selected, self.shown.handle
        if index is None or number is None:
            raise EditError("handle: expected a selected handle, got none; click one")
        return index, number

    @property
    def _mirror(self) -> Mirror | None:
        """The plane across which handles move in pairs; None where they do not."""
        if self.shown.mirror == "off":
            return None
        return Mirror.of(self.asset.points[self.body], AXES.index(self.shown.mirror))

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

    def _refuse_useless(self, raw: dict[str, Any], point: int, index: int) -> None:
        if bool(self.session.state.frozen[point]):
            raise EditError("handle: this place is frozen; take another, or unfreeze everything")
        if point in handle_points(raw, arriving(self.session.state, index).points):
            raise EditError("handle: there is one at this very place already")
