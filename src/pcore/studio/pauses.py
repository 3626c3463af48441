"""What waits until nothing was wished for a while."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


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
