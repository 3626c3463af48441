"""What a page can ask for about keys and time, each by its name."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from pcore.errors import EditError
from pcore.studio.editor import Editor

if TYPE_CHECKING:
    from pcore.studio.studio import Studio

_STEP = 0.08
"""Seconds between two frames while the timeline plays."""
_PLAY = 0.02
"""Time of the timeline that a frame is, as a share of all."""


class TimeActions:
    """The wishes as methods; they run in the worker and raise `PcoreError`."""

    def __init__(self, studio: Studio) -> None:
        """Act on a page.

        Args:
            studio: whose editor and panels.
        """
        self._studio = studio
        self.playing = False

    @property
    def _editor(self) -> Editor:
        return self._studio.editor

    def _index(self) -> int:
        index = self._editor.shown.selected
        if index is None:
            raise EditError("expected a selected edit, got none; click one in the list")
        return index

    def time(self, time: float) -> None:
        """Go to a time."""
        self._editor.at(time)

    def key(self, easing: str | None = None) -> None:
        """Key the selected edit."""
        self._editor.key(self._index(), easing)

    def unkey(self, easing: str | None = None) -> None:
        """Take the keys of the selected edit at this time away; no easing counts."""
        self._editor.unkey(self._index())

    def play(self, on: bool | None = None) -> None:
        """Let the timeline run, or stop it; None changes that."""
        on = not self.playing if on is None else on
        if on == self.playing:
            return
        self.playing = on
        if on:
            threading.Thread(target=self._run_time, name="pcore timeline", daemon=True).start()

    def step(self, by: int) -> None:
        """Go on so many steps of the timeline, or back."""
        self.playing = False
        first, last = self._ends()
        time = self._editor.session.time + by * _PLAY * (last - first)
        # The times of keys are met to the last digit.
        self._editor.at(min(max(round(time, 9), first), last))

    def jump(self, by: int) -> None:
        """Go to the next key, or the one before; nothing where there is none."""
        self.playing = False
        now = self._editor.session.time
        away = [time for time in self._editor.key_times if (time - now) * by > 0]
        if away:
            self._editor.at(min(away) if by > 0 else max(away))

    def _ends(self) -> tuple[float, float]:
        """Where the slider of the timeline begins and ends."""
        times = [0.0, 1.0, *self._editor.key_times]
        return min(times), max(times)

    def _pass(self, time: float) -> None:
        self._editor.at(time)
        self._studio.panels.at(time)

    def _run_time(self) -> None:
        pause = threading.Event()
        while self.playing:
            times = self._editor.key_times or [0.0, 1.0]
            length = max(times[-1] - times[0], 1e-9)
            time = self._editor.session.time
            later = (time - times[0] + _PLAY * length) % length + times[0]
            self._studio.newest("play", lambda later=later: self._pass(later), light=True)
            pause.wait(_STEP)
