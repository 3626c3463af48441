"""Handles on the page: a ball each, and for the selected one what moves and turns it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcore.geometry.point_cloud import size_of
from pcore.studio.cage_handles import KINDS
from pcore.studio.edit_forms import AXES
from pcore.studio.edit_handles import TURNING
from pcore.studio.editor import Editor
from pcore.studio.handle_pose import STILL, HandlePose
from pcore.studio.page_frame import SIZE, PageFrame
from pcore.studio.scaling import scaling_of

Dragged = Callable[[int, str, HandlePose], None]
"""Told the number of the tab, the phase ("start", "update", "end") and where the handle is."""
Scaled = Callable[[int, str, float], None]
"""Told the number of the tab, the phase, and how many times as large something is to be."""
_RADIUS = 0.016 * SIZE
_GIZMO = 0.14 * SIZE
_SMALL = 0.009 * SIZE
"""Radius of a ball where there are many, as of a cage."""
_BALL, _PIN, _HELD, _WARNING = (0, 150, 136), (69, 90, 100), (255, 130, 0), (220, 30, 30)
_BEFORE = 1.1 * _GIZMO
"""How far before the selected ball another one is, which is seen and taken in its place."""


@dataclass(frozen=True)
class Grab:
    """Where a ball was taken, all on the page.

    Pages tell where the pointer is in a plane, as the picture's, through what was taken of a node.

    Attributes:
        ball: (3,) where its handle was.
        taken: (3,) where the node was taken.
        farther: how many times as far from the camera as that plane the handle is.
    """

    ball: NDArray[np.float64]
    taken: NDArray[np.float64]
    farther: float

    @classmethod
    def of(cls, ball: ArrayLike, taken: ArrayLike, eye: ArrayLike) -> Grab:
        """Take a ball (3,) at a place (3,) of a node, as seen from an eye (3,)."""
        place, there, start = (np.asarray(one, dtype=np.float64) for one in (ball, taken, eye))
        way = place - start
        farther = float(way @ way) / max(float(way @ (there - start)), 1e-9)
        return cls(place, there, farther)

    def at(self, pointer: ArrayLike) -> NDArray[np.float64]:
        """Where the handle is once the pointer is at (3,) in that plane."""
        away = np.asarray(pointer, dtype=np.float64) - self.taken
        return self.ball + self.farther * away


class HandleNodes:
    """The balls and the gizmo, in the scene that all tabs share."""

    def __init__(
        self,
        scene: Any,
        frame: PageFrame,
        *,
        selected: Callable[[int, int], None],
        dragged: Dragged,
        scaled: Scaled,
    ) -> None:
        """Begin with none.

        Args:
            scene: of viser's server.
            frame: where things are on the page.
            selected: told the numbers of the tab and of a handle that was clicked or grabbed.
            dragged: told where the selected one is dragged.
            scaled: told how far its arrows are pulled where they scale.
        """
        self._scene, self._frame = scene, frame
        self._selected, self._dragged, self._scaled = selected, dragged, scaled
        self._balls: list[Any] = []
        self._gizmo: Any = None
        self._shapes: Any = None
        self._grip: Any = None
        self._turn, self._turning, self._scaling = STILL, False, False
        self._by_ball = self._held = self._pulled = False
        self._number: int | None = None
        self._eye, self._grab = (
            np.array([SIZE, -SIZE, SIZE]),
            Grab.of((0, 0, 0), (0, 0, 0), (1, 0, 0)),
        )
        self._client: Any = None
        self._front: Any = None

    def release(self) -> None:
        """Hear no more of a drag that goes on: it was put back."""
        self._held = self._pulled = False

    def face(self, client: Any) -> None:
        """Show the selected ball before all else in the tab that edits.

        Its arrows begin within it and are before it from many sides: they would be taken in its
        place. The surface may hide it as well.
        """
        if client is not self._client:
            if self._front is not None:
                self._front.remove()
            self._client, self._front = client, None
        self.turned()

    def turned(self) -> None:
        """Put the ball that is before all else between the selected one and the eye of now."""
        ball, client = self._chosen, self._client
        if self._front is not None and ball is None:
            self._front.remove()
            self._front = None
        if ball is None or client is None:
            return
        place, self._eye = np.asarray(ball.position), np.asarray(client.camera.position)
        way = self._eye - place
        away = max(float(np.linalg.norm(way)), 1e-9)
        nearer = min(_BEFORE / away, 0.5)
        if self._front is None:
            self._front = client.scene.add_icosphere("/front", cast_shadow=False)
            self._wire(self._front, None)
        self._front.position = place + nearer * way
        self._front.radius, self._front.color = (1 - nearer) * ball.radius, ball.color

    @property
    def _chosen(self) -> Any:
        """The ball of the selected handle; None without."""
        number, balls = self._number, self._balls
        return balls[number] if number is not None and number < len(balls) else None

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
        self._regrip(handles, selected, editor)
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
            moved = (moved or self._by_ball) and not self._pulled
            if moved and self._gizmo is not None:
                self._gizmo.position = self._frame.to_page(handles[selected].place)
                self._gizmo.wxyz = self._turn if self._turning else STILL
        self._number = selected
        self.turned()

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

    def _wire(self, ball: Any, number: int | None) -> None:
        """Tell of clicks and drags of a ball; None: the one before the selected ball."""

        def select(event: Any) -> None:
            which = self._number if number is None else number
            if which is not None:
                self._selected(int(event.client_id), which)

        @ball.on_click
        async def _(event: Any) -> None:
            select(event)

        @ball.on_drag
        async def _(event: Any) -> None:
            taken = self._chosen if number is None else ball
            if event.phase == "start" and taken is not None:
                select(event)
                self._grab = Grab.of(taken.position, event.start_position, self._eye)
            self._by_ball = event.phase != "end"
            self._tell(event, self._grab.at(event.end_position), None)

    def _regrip(self, handles: Sequence[HandlePose], selected: int | None, editor: Editor) -> None:
        """Give the selected handle arrows, and rings where it turns and no axis is locked."""
        shown, raw = editor.shown, editor.present
        kind, lock, gizmo = None if raw is None else raw["type"], shown.lock, shown.gizmo
        scales = raw is not None and scaling_of(raw, size_of(editor.asset.points)) is not None
        grip = (len(handles), selected, kind, lock, gizmo, scales)
        if grip == self._grip:
            return
        self._grip = grip
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None
        free = lock == "off"
        self._scaling = gizmo == "scale"
        # Locked axes are those of the world, and so are the arrows then, and arrows alone.
        self._turning = kind in TURNING and (gizmo == "turn" or (gizmo == "all" and free))
        useless = (gizmo == "turn" and not self._turning) or (self._scaling and not scales)
        if selected is None or useless:
            return
        pulled = gizmo in ("all", "move")
        self._gizmo = self._scene.add_transform_controls(
            "/gizmo",
            scale=_GIZMO,
            position=self._frame.to_page(handles[selected].place),
            wxyz=handles[selected].turn if self._turning else STILL,
            active_axes=tuple(free or not pulled or name == lock for name in AXES),
            disable_axes=gizmo == "turn",
            disable_sliders=not (free and pulled),
            disable_rotations=not self._turning,
            depth_test=False,
            opacity=0.8,
        )

        @self._gizmo.on_update
        async def _(event: Any) -> None:
            if self._scaling:
                self._tell_scale(event)
                return
            turn = event.target.wxyz if self._turning else None
            self._tell(event, event.target.position, turn)

    def _hears(self, event: Any) -> bool:
        """Whether an event is of a drag that was not put back."""
        if event.client_id is None:
            return False
        self._held = event.phase == "start" or self._held
        return event.phase != "update" or self._held

    def _tell_scale(self, event: Any) -> None:
        """An arrow that is pulled by its length makes what it scales twice as large."""
        ball = self._chosen
        if not self._hears(event) or ball is None:
            return
        way = np.asarray(event.target.position) - np.asarray(ball.position)
        share = 1 + float(way.sum()) / _GIZMO
        self._pulled = event.phase != "end"
        self._scaled(int(event.client_id), event.phase, share)

    def _tell(self, event: Any, position: Any, wxyz: Any) -> None:
        if not self._hears(event):
            return
        x, y, z = self._frame.to_world(position).tolist()
        # Who drags the ball itself turns nothing.
        turn = self._turn if wxyz is None else wxyz
        a, b, c, d = (float(value) for value in turn)
        pose = HandlePose(place=(x, y, z), turn=(a, b, c, d))
        self._dragged(int(event.client_id), event.phase, pose)
