"""Handles on the page: a ball each, and for the selected one what moves and turns it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pcore.studio.cage_handles import KINDS
from pcore.studio.edit_forms import AXES
from pcore.studio.edit_handles import TURNING
from pcore.studio.editor import Editor
from pcore.studio.handle_pose import STILL, HandlePose
from pcore.studio.page_frame import SIZE, PageFrame

Dragged = Callable[[int, str, HandlePose], None]
"""Told the number of the tab, the phase ("start", "update", "end") and where the handle is."""
_RADIUS = 0.016 * SIZE
_GIZMO = 0.14 * SIZE
_SMALL = 0.009 * SIZE
"""Radius of a ball where there are many, as of a cage."""
_BALL, _PIN, _HELD, _WARNING = (0, 150, 136), (69, 90, 100), (255, 130, 0), (220, 30, 30)


class HandleNodes:
    """The balls and the gizmo, in the scene that all tabs share."""

    def __init__(
        self,
        scene: Any,
        frame: PageFrame,
        *,
        selected: Callable[[int, int], None],
        dragged: Dragged,
    ) -> None:
        """Begin with none.

        Args:
            scene: of viser's server.
            frame: where things are on the page.
            selected: told the numbers of the tab and of a handle that was clicked or grabbed.
            dragged: told where the selected one is dragged.
        """
        self._scene, self._frame = scene, frame
        self._selected, self._dragged = selected, dragged
        self._balls: list[Any] = []
        self._gizmo: Any = None
        self._shapes: Any = None
        self._grip: Any = None
        self._turn, self._turning = STILL, False
        self._by_ball = self._held = False

    def release(self) -> None:
        """Hear no more of a drag that goes on: it was put back."""
        self._held = False

    def show(self, editor: Editor, *, warn: bool, moved: bool) -> None:
        """Show the handles of an editor where they are.

        Args:
            editor: whose selected edit.
            warn: space folds where one is dragged to.
            moved: also put the gizmo where its handle is; not while somebody holds it.
        """
        handles, selected = editor.handles, editor.shown.handle
        kind = None if editor.present is None else editor.present["type"]
        if selected is not None and selected >= len(handles):
            selected = None
        self._rebuild(handles, str(kind))
        self._regrip(handles, selected, str(kind), editor.shown.lock)
        for number, (ball, handle) in enumerate(zip(self._balls, handles, strict=True)):
            place = self._frame.to_page(handle.place)
            if not np.array_equal(ball.position, place):
                ball.position = place
            color = _PIN if handle.rests else _BALL
            if number == selected:
                color = _WARNING if warn else _HELD
            if ball.color != color:
                ball.color = color
        if selected is not None:
            self._turn = handles[selected].turn
            if (moved or self._by_ball) and self._gizmo is not None:
                self._gizmo.position = self._frame.to_page(handles[selected].place)
                self._gizmo.wxyz = self._turn if self._turning else STILL

    def _rebuild(self, handles: Sequence[HandlePose], kind: str) -> None:
        """Make the balls anew where they are others; one that is held stays the same node."""
        if self._shapes == (len(handles), kind):
            return
        for ball in self._balls:
            ball.remove()
        self._shapes, self._balls = (len(handles), kind), []
        for number, handle in enumerate(handles):
            ball = self._scene.add_icosphere(
                f"/handles/{number}",
                radius=_SMALL if kind in KINDS else _RADIUS,
                color=_BALL,
                position=self._frame.to_page(handle.place),
            )
            self._wire(ball, number)
            self._balls.append(ball)

    def _wire(self, ball: Any, number: int) -> None:
        @ball.on_click
        async def _(event: Any) -> None:
            self._selected(int(event.client_id), number)

        @ball.on_drag
        async def _(event: Any) -> None:
            if event.phase == "start":
                self._selected(int(event.client_id), number)
            self._by_ball = event.phase != "end"
            self._tell(event, event.end_position, None)

    def _regrip(
        self, handles: Sequence[HandlePose], selected: int | None, kind: str, lock: str
    ) -> None:
        """Give the selected handle arrows, and rings where it turns and no axis is locked."""
        grip = (len(handles), selected, kind, lock)
        if grip == self._grip:
            return
        self._grip = grip
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None
        if selected is None:
            return
        free = lock == "off"
        # Locked axes are those of the world, and so are the arrows then.
        self._turning = free and kind in TURNING
        self._gizmo = self._scene.add_transform_controls(
            "/gizmo",
            scale=_GIZMO,
            position=self._frame.to_page(handles[selected].place),
            wxyz=handles[selected].turn if self._turning else STILL,
            active_axes=tuple(free or name == lock for name in AXES),
            disable_sliders=not free,
            disable_rotations=not self._turning,
            depth_test=False,
            opacity=0.8,
        )

        @self._gizmo.on_update
        async def _(event: Any) -> None:
            turn = event.target.wxyz if self._turning else None
            self._tell(event, event.target.position, turn)

    def _tell(self, event: Any, position: Any, wxyz: Any) -> None:
        if event.client_id is None:
            return
        self._held = event.phase == "start" or self._held
        if event.phase == "update" and not self._held:
            return
        x, y, z = self._frame.to_world(position).tolist()
        # Who drags the ball itself turns nothing.
        turn = self._turn if wxyz is None else wxyz
        a, b, c, d = (float(value) for value in turn)
        pose = HandlePose(place=(x, y, z), turn=(a, b, c, d))
        self._dragged(int(event.client_id), event.phase, pose)
