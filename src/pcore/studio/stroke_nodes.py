"""Strokes on the page: what catches them, and the line that shows them while they are drawn."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
from torch import Tensor

from pcore.geometry.camera import Camera
from pcore.studio.page_frame import PageFrame
from pcore.studio.viewport import Viewport

HELD = {"shift": "replace", "cmd/ctrl+shift": "add", "alt+shift": "subtract"}
"""What a stroke does to the selection by the keys that are held."""
_FAR = 6000.0
"""Side of the box around everything whose inside is dragged over; pages show nothing there."""
_NEAR = 1.0
"""How far before the camera a line is, on the page."""
_INK = (214, 0, 160)
Stroked = Callable[[Any, str], None]
"""Told an event of viser's with a phase and places, and what the stroke does."""
Boxed = Callable[[Any], Coroutine[Any, Any, None]]


class StrokeNodes:
    """viser tells where a drag is only for things that are dragged: a box around everything."""

    def __init__(self, scene: Any, frame: PageFrame, stroked: Stroked, boxed: Boxed) -> None:
        """Begin without.

        Args:
            scene: that all tabs share.
            frame: where things are on the page.
            stroked: told of drags with one of the keys of `HELD`.
            boxed: told of boxes that were drawn with one of them.
        """
        self._scene, self._frame, self._boxed = scene, frame, boxed
        self._boxes = self._clicks = False
        self._catcher = scene.add_box(
            "/strokes",
            dimensions=(_FAR, _FAR, _FAR),
            side="back",
            opacity=0.0,
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
        for keys, how in HELD.items():
            self._wire(keys, how, stroked)

    def _wire(self, keys: str, how: str, stroked: Stroked) -> None:
        @self._catcher.on_drag("left", modifier=keys)
        async def _(event: Any) -> None:
            stroked(event, how)

    def use(self, tool: str) -> None:
        """Let the page draw boxes, or catch the strokes of another tool."""
        boxes = tool == "box"
        if boxes == self._boxes:
            return
        self._boxes, self._catcher.visible = boxes, not boxes
        if not boxes:
            self._scene.remove_rect_select_callback()
            return
        for keys in HELD:
            self._scene.on_rect_select(modifier=keys)(self._boxed)

    def hear(self, clicked: Any, on: bool) -> None:
        """Tell of clicks without a key from now on, or leave them to the page."""
        if on == self._clicks:
            return
        self._clicks = on
        if on:
            self._scene.on_click()(clicked)
        else:
            self._scene.remove_click_callback(clicked)
            for keys in ("cmd/ctrl", "alt", *HELD):
                self._scene.on_click(modifier=keys)(clicked)

    def draw(self, viewport: Viewport, camera: Camera, outline: Tensor) -> None:
        """Show a line over a tab's picture: columns and rows (S, 2); none with fewer than two."""
        if len(outline) < 2:
            viewport.show_ink(None, _INK)
            return
        rays = camera.rays(height=1, width=1, places=outline)
        origins, ways = rays.origins.reshape(-1, 3), rays.directions.reshape(-1, 3)
        page = self._frame.to_page((origins + ways * (_NEAR / self._frame.scale)).numpy())
        viewport.show_ink(np.stack([page[:-1], page[1:]], axis=1), _INK)
