"""Brings an editor's state to the tabs: splats at once, pictures when things rest."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from pcore.asset.asset import Posed
from pcore.geometry.torch_threads import one_thread
from pcore.studio.drawing import Drawer
from pcore.studio.editor import Editor
from pcore.studio.page_frame import PageFrame
from pcore.studio.viewport import (
    MOST_PIXELS,
    Viewport,
    page_depth,
    pixels_of,
    side_by_side,
)

_COARSE = 0.25
"""Share of the pixels of the first picture at rest."""


class Showing:
    """What the worker draws with; the editor may be replaced."""

    def __init__(self, editor: Editor, drawer: Drawer, frame: PageFrame) -> None:
        """Keep them."""
        self.editor, self._drawer, self._frame = editor, drawer, frame

    def move(self, viewports: Sequence[Viewport]) -> None:
        """Show the present state, its overlay, and red diamonds where it folds.

        By splats, or by small exact pictures where those are wished.
        """
        state, side = self.editor.state, self.editor.shown.exact
        for viewport in viewports:
            camera = viewport.camera(most=side * side) if side else None
            if camera is None:
                with one_thread():
                    self._shapes(viewport)
                viewport.moving()
                continue
            picture = self._drawer.quick_picture(state, camera, still=self.editor.shown.still)
            viewport.show_picture(pixels_of(picture), page_depth(picture, self._frame))
        with one_thread():
            self._dots(viewports, moving=True)

    def rest(self, viewports: Sequence[Viewport], cancelled: Callable[[], bool]) -> Iterator[None]:
        """Show overlays, then ever better pictures, tab by tab."""
        editor = self.editor
        editor.refine()
        self._dots(viewports)
        yield
        if not editor.shown.rest:
            for viewport in viewports:
                self._shapes(viewport)
                viewport.moving(stays=True)
            yield  # Who asks between steps sees that every tab shows something.
            return
        first = self._drawer.first(editor.state, still=editor.shown.still)
        if first is not None:  # Nobody waits for the light, and it may not be wanted any more.
            for viewport in viewports:
                yield from self._pictures(viewport, _COARSE, first, cancelled)
        yield
        posed = self._drawer.posed(editor.state, still=editor.shown.still)
        yield
        for viewport in viewports:
            # The colours that this place sees, in the light of now.
            self._shapes(viewport)
            yield
            for part in (_COARSE, 1.0):
                yield from self._pictures(viewport, part, posed, cancelled)

    def _shapes(self, viewport: Viewport) -> None:
        """Show splats, or points where those are wished."""
        splats = self._drawer.splats(self.editor.state, viewport.eye)
        if self.editor.shown.moving == "points":
            viewport.show_points(splats, self.editor.spacing)
        else:
            viewport.show_splats(splats)

    def _pictures(
        self, viewport: Viewport, part: float, posed: Posed, cancelled: Callable[[], bool]
    ) -> Iterator[None]:
        """Show ever better pictures with a part of the pixels."""
        camera = viewport.camera(most=int(part * MOST_PIXELS))
        if camera is None:
            return
        editor, share = self.editor, self.editor.shown.compare
        before = pixels_of(self._drawer.before(camera)) if share > 0 else None
        yield
        for picture in self._drawer.pictures(posed, camera, cancelled):
            pixels = pixels_of(picture)
            if before is not None:
                pixels = side_by_side(before, pixels, share)
            if cancelled():
                return
            marked = bool(editor.handles)
            viewport.show_picture(pixels, page_depth(picture, self._frame) if marked else None)
            yield

    def _dots(self, viewports: Sequence[Viewport], *, moving: bool = False) -> None:
        editor, shown = self.editor, self.editor.shown
        found = self._drawer.dots(editor.state, shown.overlay, shown.chosen, moving=moving)
        for viewport in viewports:
            viewport.show_dots(found.points, found.colors, found.folds)
