"""Handles on the page: a ball each, and for the selected one what moves and turns it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pcore.studio.handle_edit import STILL, HandlePose
from pcore.studio.page_frame import SIZE, PageFrame

Dragged = Callable[[int, str, HandlePose], None]
"""Told the number of the tab, the phase ("start", "update", "end") and where the handle is."""
_RADIUS = 0.016 * SIZE
_GIZMO = 0.14 * SIZE
_BALL, _HELD, _WARNING = (0, 150, 136), (255, 130, 0), (220, 30, 30)


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
        self._held: int | None = None
        self._turn = STILL
        self._by_ball = False

    def show(
        self, handles: Sequence[HandlePose], selected: int | None, *, warn: bool, moved: bool
    ) -> None:
        """Show handles where they are.

        Args:
            handles: of the selected edit.
            selected: number of the one with the gizmo.
            warn: space folds where it is dragged to.
            moved: also put the gizmo where its handle is; not while somebody holds it.
        """
        if len(handles) != len(self._balls) or selected != self._held:
            self._rebuild(handles, selected)
        for ball, handle in zip(self._balls, handles, strict=True):
            ball.position = self._frame.to_page(handle.place)
        if selected is not None:
            self._turn = handles[selected].turn
            self._balls[selected].color = _WARNING if warn else _HELD
            if (moved or self._by_ball) and self._gizmo is not None:
                self._gizmo.position = self._frame.to_page(handles[selected].place)
                self._gizmo.wxyz = handles[selected].turn

    def _rebuild(self, handles: Sequence[HandlePose], selected: int | None) -> None:
        for node in [*self._balls, self._gizmo]:
            if node is not None:
                node.remove()
        self._balls, self._gizmo, self._held = [], None, selected
        for number, handle in enumerate(handles):
            color = _HELD if number == selected else _BALL
            ball = self._scene.add_icosphere(
                f"/handles/{number}",
                radius=_RADIUS,
                color=color,
                position=self._frame.to_page(handle.place),
            )
            self._wire(ball, number)
            self._balls.append(ball)
        if selected is not None:
            self._add_gizmo(handles[selected])

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

    def _add_gizmo(self, handle: HandlePose) -> None:
        self._gizmo = self._scene.add_transform_controls(
            "/gizmo",
            scale=_GIZMO,
            position=self._frame.to_page(handle.place),
            wxyz=handle.turn,
            depth_test=False,
            opacity=0.8,
        )

        @self._gizmo.on_update
        async def _(event: Any) -> None:
            self._tell(event, event.target.position, event.target.wxyz)

    def _tell(self, event: Any, position: Any, wxyz: Any) -> None:
        if event.client_id is None:
            return
        x, y, z = self._frame.to_world(position).tolist()
        # Who drags the ball itself turns nothing.
        turn = self._turn if wxyz is None else wxyz
        a, b, c, d = (float(value) for value in turn)
        pose = HandlePose(place=(x, y, z), turn=(a, b, c, d))
        self._dragged(int(event.client_id), event.phase, pose)
