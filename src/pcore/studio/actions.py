"""What widgets and keys of a page can ask for, each by its name."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pcore.editing.anchors_edit import AnchorsEdit
from pcore.editing.picking import pick
from pcore.errors import EditError
from pcore.geometry.point_cloud import size_of
from pcore.studio.edit_forms import AXES, CAGES
from pcore.studio.help_text import NO_PHOTOS, NO_SCALE, OVERLAY_LEGENDS
from pcore.studio.scaling import Scaling, scaling_of
from pcore.studio.shown import OVERLAYS
from pcore.studio.time_actions import TimeActions
from pcore.studio.viewport import Viewport

if TYPE_CHECKING:
    from pcore.studio.studio import Studio

COMMANDS = (
    *("add", "enable", "order", "cancel", "finish", "reach", "put", "turn", "widen", "set"),
    *("play", "step", "jump", "key", "unkey", "overlay", "points", "before"),
    *("mirror", "lock", "gizmo", "save", "open"),
)
"""Wishes that are all fulfilled, in their order."""
EDITOR_COMMANDS = ("undo", "redo", "select", "remove_handle", "freeze", "thaw")
"""Such wishes that are commands of the editor itself."""
SHOWN = ("still", "moving", "rest", "click", "tool")
"""Such wishes that are values of `Shown`."""
NEWEST = ("rename", "time")
"""Wishes of which only the newest counts."""
NEWEST_SHOWN = ("compare", "brush")
"""Such wishes that are values of `Shown`."""
OF_TAB = ("camera_key", "screenshot", "film")
"""Wishes that are all fulfilled and need to know which tab has them."""


class Actions(TimeActions):
    """The wishes as methods; they run in the worker and raise `PcoreError`."""

    def __init__(self, studio: Studio) -> None:
        """Act on a page.

        Args:
            studio: whose editor and files.
        """
        super().__init__(studio)
        self.save, self.open = studio.files.save, studio.files.open
        self.camera_key = studio.files.camera_key
        self.screenshot, self.film = studio.files.screenshot, studio.files.film

    def add(self, kind: str) -> None:
        """Add an edit, or one of `CAGES`."""
        if kind in CAGES:
            file = self._studio.outputs.next("cage", ".ply")
            self._editor.add_cage(file, cells=CAGES[kind])
        else:
            self._editor.add(kind)

    def set(self, index: int, path: str, value: Any) -> None:
        """Change a value of an edit, as a step of its own."""
        self._editor.begin()
        self._editor.set(index, path, value)

    def settle(self) -> None:
        """Keep what a slider shows."""
        self._stays(self._editor.settle())

    def rename(self, index: int, name: str) -> None:
        """Name an edit."""
        self._editor.rename(index, name or None)

    def enable(self, index: int, on: bool) -> None:
        """Let an edit act, or leave it out."""
        self._editor.session.mute(index, not on)

    def order(self, index: int, what: str) -> None:
        """Move, copy or delete an edit."""
        if what in ("Up", "Down"):
            self._editor.move(index, -1 if what == "Up" else 1)
        elif what == "Copy":
            self._editor.duplicate(index)
        elif what == "Delete":
            self._editor.remove(index)
        else:
            raise EditError(f"order: expected Up, Down, Copy or Delete, got {what!r}")

    def cancel(self) -> None:
        """Put a drag back, or a stroke."""
        if not self._studio.selecting.take_back():
            self._editor.cancel()

    def overlay(self, name: str | None = None) -> None:
        """Show an overlay; None is the next one."""
        names: list[str] = list(OVERLAYS)
        now = names.index(self._editor.shown.overlay)
        name = name or names[(now + 1) % len(names)]
        self.show(overlay=name)
        blind = name == "exposed" and not self._studio.drawer.has_photos
        self._studio.say(NO_PHOTOS if blind else OVERLAY_LEGENDS[name])

    def before(self) -> None:
        """Show the object before the edits in half of the picture, or no more."""
        self.show(compare=0.0 if self._editor.shown.compare else 0.5)

    def points(self) -> None:
        """Show points while things move, or splats again."""
        self.show(moving="splats" if self._editor.shown.moving == "points" else "points")

    def widen(self) -> None:
        """Do what folded, with soft edges wide enough."""
        falloff = self._editor.widen()
        self._studio.say(f"It holds with soft edges of {falloff:.3g} world units.")

    def mirror(self, axis: str | None = None) -> None:
        """Across which axis handles move in pairs; None is the next one."""
        names = ("off", *AXES)
        now = names.index(self._editor.shown.mirror)
        self.show(mirror=axis or names[(now + 1) % len(names)])

    def lock(self, axis: str) -> None:
        """Let handles move along one axis alone; the same once more, or "off", lets them go."""
        self.show(lock="off" if axis == self._editor.shown.lock else axis)

    def gizmo(self, what: str) -> None:
        """What arrows and rings do, one of `GIZMOS`; the same once more: move and turn."""
        what = "all" if what == self._editor.shown.gizmo else what
        self.show(gizmo=what)
        raw = self._editor.present
        if what == "scale" and raw is not None and self._scaling(raw) is None:
            self._studio.say(NO_SCALE)

    def scale(self, share: float) -> None:
        """Show what the selected handle scales so many times as large; `settle` keeps it."""
        index = self._index()
        if (found := self._scaling(self._editor.raw(index))) is not None:
            self._editor.slide(index, found.path, found.times(share))

    def finish(self) -> None:
        """Select no edit: the next handle begins another one."""
        self._editor.select(None)

    def reach(self, by: float) -> None:
        """Let the selected handles reach so many times as far."""
        raw, index = self._editor.present, self._index()
        if raw is None or raw["type"] != "anchors":
            raise EditError("reach: expected an edit by handles, got none; Ctrl-click the object")
        size = size_of(self._editor.asset.points)
        self._editor.set(index, "reach", AnchorsEdit.reach_of(raw.get("reach"), size) * by)

    def put(self, place: Any) -> None:
        """Put the selected handle at a place (3,), world units."""
        self._stays(self._editor.put(place=place))

    def turn(self, degrees: Any) -> None:
        """Turn the selected handle by angles about x, y and z."""
        self._stays(self._editor.put(degrees=degrees))

    def place(self, viewport: Viewport, place: tuple[float, float], pin: bool = False) -> None:
        """Put a handle, or a pin, where a tab's picture shows the object, in shares of it."""
        editor, camera = self._editor, viewport.camera()
        if camera is None:
            return
        column, row = place[0] * camera.width, place[1] * camera.height
        hit = pick(editor.state, camera, column, row, spacing=editor.spacing)
        if hit is None:
            raise EditError("handle: there is nothing under the pointer")
        editor.place_handle(hit.point, pin=pin)

    def drop(self) -> None:
        """Keep what is dragged."""
        back = self._editor.back
        self._stays(self._editor.drop(), back)

    def show(self, **changes: Any) -> None:
        """Show the object in other ways: values of `Shown`."""
        self._editor.shown = replace(self._editor.shown, **changes)

    def _stays(self, there: bool, back: str = "") -> None:
        if not there:
            by = f", {back} away" if back else ""
            raise EditError(f"space would fold there; back to the last place where it did not{by}")

    def _scaling(self, raw: dict[str, Any]) -> Scaling | None:
        return scaling_of(raw, size_of(self._editor.asset.points))
