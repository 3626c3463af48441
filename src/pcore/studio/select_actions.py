"""What a page can ask for about its selection, each by its name."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from pcore.data.points import read_array
from pcore.editing.selection import save_mask
from pcore.errors import EditError, InputError
from pcore.studio.editor import Editor
from pcore.studio.guard import is_file_name
from pcore.studio.stroke import Stroke
from pcore.studio.stroke_nodes import HELD
from pcore.studio.viewport import Viewport

if TYPE_CHECKING:
    from pcore.studio.studio import Studio

SELECT_COMMANDS = (
    *("visible_only", "selection"),
    *("where", "name_selection", "take_selection", "forget_selection"),
)
"""Wishes that are all fulfilled, in their order."""
EVERYWHERE, SELECTED = "everywhere", "the selection"


class SelectActions:
    """The wishes as methods; they run in the worker and raise `PcoreError`."""

    def __init__(self, studio: Studio) -> None:
        """Act on a page.

        Args:
            studio: whose editor.
        """
        self._studio = studio
        self._visible_only = True
        self._stroke: Stroke | None = None
        self._lock = threading.Lock()
        self._places, self._fresh = list[Any](), False
        folder, count = studio.outputs.folder / "selections", len(studio.editor.asset.points)
        self.named = NamedSelections(folder=folder, count=count)

    @property
    def _editor(self) -> Editor:
        return self._studio.editor

    def visible_only(self, on: bool) -> None:
        """Whether what is covered is left out."""
        self._visible_only = on

    def selection(self, what: str) -> None:
        """Invert, grow, shrink or clear the selection."""
        if what == "Clear":
            self._editor.choose(torch.zeros(len(self._editor.asset.points), dtype=torch.bool))
        elif what in ("Invert", "Grow", "Shrink"):
            getattr(self._editor, what.lower())()
        else:
            raise EditError(f"selection: expected Invert, Grow, Shrink or Clear, got {what!r}")

    def where(self, index: int, name: str) -> None:
        """Let an edit act everywhere, in the selection, or in one with a name."""
        if name == EVERYWHERE:
            self._editor.limit(index)
        else:
            chosen = self._editor.mask if name == SELECTED else self.named.read(name)
            self._editor.limit(index, chosen)

    def name_selection(self, name: str) -> None:
        """Keep the selection under a name."""
        self.named.keep(name, self._editor.mask)
        self._studio.say(f"Kept {len(self._editor.shown.chosen):,} points as {name}.")

    def take_selection(self, name: str, how: str = "replace") -> None:
        """Select what has a name."""
        self._editor.choose(self.named.read(name), how=how)

    def forget_selection(self, name: str) -> None:
        """Forget a name; edits that act there go on to do so."""
        self.named.forget(name)

    def choose(self, viewport: Viewport, lower: Any, upper: Any, how: str) -> None:
        """Select the points in a rectangle of a tab, in shares of its picture."""
        editor, camera = self._editor, viewport.camera()
        if camera is not None:
            sides = (camera.width, camera.height)
            left, top, right, bottom = (
                share * side for share, side in zip((*lower, *upper), sides * 2, strict=True)
            )
            inside = editor.selector.box(
                editor.state.points.float(),
                camera,
                (left, top, right, bottom),
                through=not self._visible_only,
            )
            editor.choose(inside, how=how)

    def dab(self, viewport: Viewport, place: tuple[float, float], how: str) -> None:
        """Select what a click means: a dab of the brush, or a ball."""
        if self._editor.shown.tool in ("brush", "ball"):
            self._begin(viewport, how)
            if self._stroke is not None:
                self._stroke.add(place)
                self._stroke.apply()
            self._stroke = None

    def collect(self, event: Any) -> None:
        """Keep where a stroke goes, until `stroke` takes it; also from another thread."""
        with self._lock:
            if event.phase == "start":
                self._places, self._fresh = [event.start_screen_pos], True
            self._places.append(event.end_screen_pos)

    def stroke(self, viewport: Viewport, how: str) -> None:
        """Go on with a stroke to where it was collected; see `collect`."""
        with self._lock:
            places, fresh = self._places, self._fresh
            self._places, self._fresh = [], False
        if fresh:
            self._begin(viewport, how)
        if self._stroke is None or not places:
            return
        for place in places:
            self._stroke.add(place)
        self._stroke.apply()
        self._studio.strokes.draw(viewport, self._stroke.camera, self._stroke.outline)

    def lift(self, viewport: Viewport) -> None:
        """End a stroke."""
        if self._stroke is not None:
            self._studio.strokes.draw(viewport, self._stroke.camera, torch.zeros(0, 2))
        self._stroke = None

    def take_back(self) -> bool:
        """Take a stroke back that is being drawn; whether there was one."""
        stroke, self._stroke = self._stroke, None
        if stroke is not None:
            stroke.take_back()
        return stroke is not None

    def _begin(self, viewport: Viewport, how: str) -> None:
        if how not in HELD.values():
            raise EditError(f"selection: expected replace, add or subtract, got {how!r}")
        camera = viewport.camera()
        self._stroke = (
            None
            if camera is None
            else Stroke(self._editor, camera, how=how, through=not self._visible_only)
        )


_ENDING = ".npy"


@dataclass(frozen=True, kw_only=True)
class NamedSelections:
    """Those of one object.

    Attributes:
        folder: of the files; made when first needed.
        count: of the points.
    """

    folder: Path
    count: int

    @property
    def names(self) -> list[str]:
        """In their alphabetical order."""
        return sorted(path.stem for path in self.folder.glob(f"*{_ENDING}"))

    def read(self, name: str) -> Tensor:
        """Points (N,) bool of a selection.

        Raises:
            InputError: there is none of this name, or its file cannot be read.
            EditError: it is of another object.
        """
        path = self._path(name)
        if not path.is_file():
            raise InputError(f"selection: there is none with the name {name!r}")
        mask = read_array(path)
        if mask.shape != (self.count,) or mask.dtype != bool:
            raise EditError(
                f"selection {name}: expected true or false for each of {self.count} points, got "
                f"{mask.dtype} {mask.shape}; it belongs to another object"
            )
        return torch.from_numpy(mask)

    def keep(self, name: str, mask: Tensor) -> None:
        """Keep points (N,) bool under a name; an older one of this name is replaced.

        Raises:
            InputError: a name that is none.
            EditError: nothing is selected, or the file cannot be written.
        """
        path = self._path(name)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise EditError(f"selection: cannot be kept ({error.strerror})") from error
        save_mask(path, mask)

    def forget(self, name: str) -> None:
        """Remove one; nothing where there is none."""
        self._path(name).unlink(missing_ok=True)

    def _path(self, name: str) -> Path:
        if not is_file_name(name):
            raise InputError(
                f"name of a selection: expected letters, numbers and - _ ., got {name!r}"
            )
        return self.folder / f"{name}{_ENDING}"
