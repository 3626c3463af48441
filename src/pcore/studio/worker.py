"""One thread that does all the work of a page: commands in their order, drawings newest first."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

Command = Callable[[], None]
Drawing = Callable[[Callable[[], bool]], Iterator[None]]
"""Draws in steps; it is given what says that its result is not wanted any more."""
REST = 0.15
"""Seconds without a new wish after which things rest."""
_STOP = 5.0
"""Seconds that stopping waits: autosave and server still have to be closed before the program
is ended by force (`pcore.cli.studio`)."""


class Worker:
    """Runs commands one after another; of drawings only the newest.

    A drawing that is not newest any more ends at its next step, or where it asks. What raises ends
    neither the worker nor what comes after it.
    """

    def __init__(self, failed: Callable[[Exception], None], *, rest: float = REST) -> None:
        """Begin with nothing to do.

        Args:
            failed: told what a command or a drawing raised.
            rest: seconds between a quick drawing and the one at rest.
        """
        self._failed, self._rest = failed, rest
        self._changed = threading.Condition()
        self._commands: deque[Command] = deque()
        self._moving: Command | None = None
        self._resting: Drawing | None = None
        self._jobs: deque[Iterator[object]] = deque()
        self._serial = 0
        self._ended = False
        self._busy = False
        self._thread = threading.Thread(target=self._run, name="pcore studio", daemon=True)

    def start(self) -> None:
        """Begin to work."""
        self._thread.start()

    def stop(self) -> None:
        """Finish the commands there are, and end.

        What takes longer than a few seconds goes on behind; a kernel that is compiled for the
        first time cannot be stopped.
        """
        with self._changed:
            self._ended = True
            self._serial += 1
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout=_STOP)

    def do(self, command: Command) -> None:
        """Do this after the commands before it; none is left out."""
        self._wish(lambda: self._commands.append(command))

    def go_on(self, job: Iterator[object]) -> None:
        """Do a long job step by step; everything else that is wished comes between two steps."""
        self._wish(lambda: self._jobs.append(job))

    def draw(self, moving: Command | None, resting: Drawing | None) -> None:
        """Draw this instead of what was wished before.

        Args:
            moving: quick, at once; None where nothing needs to be drawn for that.
            resting: once nothing was wished for a while; None for nothing.
        """

        def wish() -> None:
            # A quick drawing that nobody has done yet is done by the one that replaces it.
            self._moving = moving or self._moving
            self._resting = resting

        self._wish(wish)

    def wait(self, seconds: float = 10.0) -> bool:
        """Whether everything is done, within so many seconds; for tests and endings."""
        with self._changed:
            return self._changed.wait_for(
                lambda: (
                    not any((self._busy, self._commands, self._moving, self._resting, self._jobs))
                ),
                seconds,
            )

    def _wish(self, change: Callable[[], Any]) -> None:
        with self._changed:
            change()
            self._serial += 1
            self._changed.notify_all()

    def _run(self) -> None:
        while (work := self._next()) is not None:
            try:
                work()
            except Exception as error:
                self._failed(error)
            with self._changed:
                self._busy = False
                self._changed.notify_all()
        for job in self._jobs:  # Half of a file is not kept.
            getattr(job, "close", lambda: None)()

    def _next(self) -> Command | None:
        """What is to be done; waits for it. None at the end."""
        with self._changed:
            while True:
                if self._commands:
                    work: Command = self._commands.popleft()
                elif self._ended:
                    return None
                elif self._moving is not None:
                    work, self._moving = self._moving, None
                elif self._resting is not None:
                    if self._changed.wait_for(self._newer(), self._rest):
                        continue
                    work, self._resting = self._step(self._resting), None
                elif self._jobs:
                    work = self._job_step
                else:
                    self._changed.wait()
                    continue
                self._busy = True
                return work

    def _job_step(self) -> None:
        goes_on = False
        try:
            goes_on = next(self._jobs[0], self) is not self
        finally:
            if not goes_on:
                self._jobs.popleft()

    def _newer(self) -> Callable[[], bool]:
        """Says later whether anything was wished since now."""
        serial = self._serial
        return lambda: self._serial != serial

    def _step(self, drawing: Drawing) -> Command:
        newer = self._newer()

        def work() -> None:
            for _ in drawing(newer):
                if newer():
                    return

        return work
