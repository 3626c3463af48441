"""What hands do on the page: clicks, drags, strokes and sliders, each until it ends."""

from __future__ import annotations

import threading
import time
from abc import abstractmethod
from collections.abc import Callable
from typing import Any

from pcore.studio.actions import Actions
from pcore.studio.editor import Editor
from pcore.studio.handle_nodes import HandleNodes
from pcore.studio.handle_pose import HandlePose
from pcore.studio.select_actions import SelectActions
from pcore.studio.stroke_nodes import HELD
from pcore.studio.tabs import Tabs

_CLICK = 0.5
"""Seconds within which two messages are of one click."""
_PAUSE = 0.7
"""Seconds without a message after which a slider rests."""


class Gestures(Tabs):
    """Tabs with an editor, whose messages become its commands."""

    editor: Editor
    actions: Actions
    selecting: SelectActions
    nodes: HandleNodes

    def __init__(self, report: Callable[[Exception], None]) -> None:
        """Begin with nothing held; arguments as of `Tabs`."""
        super().__init__(report)
        self._grabbed = 0.0
        self._pause = Pause(_PAUSE, lambda: self.perform(self.actions.settle))

    @abstractmethod
    def _note(self) -> None:
        """Keep edits that changed."""

    def perform(self, do: Callable[[], object], *, light: bool = False) -> None:
        """As of tabs; what a slider shows is kept before anything but drags."""

        def then() -> None:
            if self.editor.sliding and do not in (self.actions.settle, self.actions.cancel):
                self.editor.settle()
                self._note()
            do()

        super().perform(do if light else then, light=light)

    def _slide(self, tab: int, index: int, path: str, value: Any) -> None:
        if self._may(tab):
            self._pause.touch()
            do = self.editor.slide
            self.newest(f"slide {index} {path}", lambda: do(index, path, value), light=True)

    def _cancel(self, tab: int) -> None:
        if self._may(tab):
            self.nodes.release()
            self.perform(self.actions.cancel)

    async def _clicked(self, event: Any) -> None:
        tab, place = int(event.client_id), event.screen_pos
        if event.modifier in HELD:
            self._of_tab(self.selecting.dab)(tab, place, HELD[event.modifier])
        elif event.modifier or time.monotonic() > self._grabbed + _CLICK:
            pin = event.modifier == "alt" or (
                not event.modifier and self.editor.shown.click == "pin"
            )
            self._of_tab(self.actions.place)(tab, place, pin)

    async def _boxed(self, event: Any) -> None:
        choose = self._of_tab(self.selecting.choose)
        how = HELD[event.modifier]
        choose(int(event.client_id), event.screen_min, event.screen_max, how)

    def _stroked(self, event: Any, how: str) -> None:
        tab = int(event.client_id)
        viewport = self._viewports.get(tab)
        if event.phase == "start" and not self._may(tab):
            return
        if viewport is None or tab != self._owner:
            return
        self.selecting.collect(event)
        if event.phase == "end":
            self.perform(lambda: self.selecting.stroke(viewport, how))
            self.perform(lambda: self.selecting.lift(viewport))
        else:
            self.newest("stroke", lambda: self.selecting.stroke(viewport, how), light=True)

    def _select_handle(self, tab: int, number: int) -> None:
        self._grabbed = time.monotonic()  # The page tells of the click behind the ball, too.
        if self._may(tab):
            self.perform(lambda: self.editor.select_handle(number))

    def _scaled(self, tab: int, phase: str, share: float) -> None:
        self._pulled(tab, phase, "scale", lambda: self.actions.scale(share), self.actions.settle)

    def _dragged(self, tab: int, phase: str, pose: HandlePose) -> None:
        self._pulled(tab, phase, "drag", lambda: self.editor.drag(pose), self.actions.drop)

    def _pulled(
        self, tab: int, phase: str, name: str, show: Callable[[], None], keep: Callable[[], None]
    ) -> None:
        """Show what the tab that edits pulls at, of which the newest counts; at its end keep it."""
        if tab != self._owner:
            return
        if phase == "end":
            self.perform(keep)
        else:
            self.newest(name, show, light=True)


class Pause:
    """Does something once nobody touched it for a while."""

    def __init__(self, seconds: float, do: Callable[[], object]) -> None:
        """Begin untouched.

        Args:
            seconds: of the while.
            do: what follows it, from a thread of its own.
        """
        self._seconds, self._do = seconds, do
        self._lock, self._waits, self._until = threading.Lock(), False, 0.0

    def touch(self) -> None:
        """Begin the while anew."""
        with self._lock:
            self._until = time.monotonic() + self._seconds
            if not self._waits:
                self._wait(self._seconds)

    def _wait(self, seconds: float) -> None:
        self._waits = True
        timer = threading.Timer(seconds, self._look)
        timer.daemon = True
        timer.start()

    def _look(self) -> None:
        with self._lock:
            left = self._until - time.monotonic()
            if left > 0:
                self._wait(left)
                return
            self._waits = False
        self._do()
