"""Tabs of a page: which of them may change the object, and how their wishes reach the worker."""

from __future__ import annotations

import re
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from pcore.errors import EditError, PcoreError
from pcore.geometry.torch_threads import one_thread
from pcore.studio.guard import plain
from pcore.studio.viewport import Viewport
from pcore.studio.worker import Worker

_FOLDS = re.compile(r"singular deformation: .*?; (.*); plain rays can draw it")
"""What a message says of a fold beside what to do about it; pages draw folds in any case."""
_SLOW = 0.5
"""Seconds after which a command is said to take its time."""


class Tabs(ABC):
    """All tabs of a page, of which one edits, and the worker that does what it wishes."""

    def __init__(self, report: Callable[[Exception], None]) -> None:
        """Begin without tabs.

        Args:
            report: told of what should not happen; the page only shows its kind.
        """
        self.worker = Worker(self._failed)
        self._report = report
        self._lock, self._latest = threading.Lock(), dict[str, Callable[[], object]]()
        self._viewports: dict[int, Viewport] = {}
        self._owner: int | None = None
        self._said = ""

    @abstractmethod
    def _refresh(self) -> None:
        """Show the state in every tab, panel and all."""

    @abstractmethod
    def _show_drag(self) -> None:
        """Show only what a drag changes."""

    @abstractmethod
    def _let_go(self) -> None:
        """Put back what is being dragged: the tab that drags edits no more."""

    @abstractmethod
    def _show_working(self) -> None:
        """Show that a command takes its time; called from another thread."""

    def say(self, text: str) -> None:
        """Show a line below the title, until the next command."""
        self._said = text

    def _join(self, viewport: Viewport) -> bool:
        """Take a tab in; whether it is the one that edits."""
        self._viewports[viewport.number] = viewport
        if self._owner is None:
            self._owner = viewport.number
        return self._owner == viewport.number

    def _leave(self, tab: int) -> None:
        """Forget a tab; where it edited, the oldest other one does."""
        self._viewports.pop(tab, None)
        if self._owner == tab:
            self._let_go()
            self._owner = next(iter(self._viewports), None)

    def _wish(self, do: Callable[..., object]) -> Callable[..., None]:
        def wish(tab: int, *values: Any) -> None:
            if self._may(tab):
                self.perform(lambda: do(*values))

        return wish

    def _of_tab(self, do: Callable[..., object]) -> Callable[..., None]:
        def wish(tab: int, *values: Any) -> None:
            viewport = self._viewports.get(tab)
            if viewport is not None and self._may(tab):
                self.perform(lambda: do(viewport, *values))

        return wish

    def _newest_of(self, name: str, do: Callable[..., object]) -> Callable[..., None]:
        def wish(tab: int, *values: Any) -> None:
            if self._may(tab):
                self.newest(f"{name} {values[:-1]}", lambda: do(*values))

        return wish

    def newest(self, name: str, do: Callable[[], object], *, light: bool = False) -> None:
        """Let the worker do this; of those with one name only the newest when it comes to it."""
        with self._lock:
            first = name not in self._latest
            self._latest[name] = do
        if first:
            self.perform(lambda: self._take(name)(), light=light)

    def _take(self, name: str) -> Callable[[], object]:
        with self._lock:
            return self._latest.pop(name)

    def perform(self, do: Callable[[], object], *, light: bool = False) -> None:
        """Let the worker do something and show what came of it; light: of a drag, the splats."""

        def command() -> None:
            done = threading.Event()
            if not light:
                self._soon(done)
            try:
                self._said = ""
                with one_thread() if light else nullcontext():
                    do()
            except PcoreError as error:
                self._complain(error)
            except OSError as error:  # A full disk, a folder that nobody may write to.
                name = Path(str(error.filename or "file")).name
                self._complain(EditError(f"{name}: {error.strerror or error}"))
            finally:
                with self._lock:
                    done.set()
            if light:
                self._show_drag()
            else:
                self._refresh()

        self.worker.do(command)

    def _soon(self, done: threading.Event) -> None:
        """Say that something takes its time, unless it is done by then."""

        def say() -> None:
            with self._lock:
                if not done.is_set():
                    self._show_working()

        timer = threading.Timer(_SLOW, say)
        timer.daemon = True
        timer.start()

    def _may(self, tab: int) -> bool:
        if tab == self._owner:
            return True
        self._tell(
            tab, "Another tab edits this object", "Edit in this tab, in the panel, goes on here."
        )
        return False

    def _take_over(self, tab: int) -> None:
        def take() -> None:
            self._let_go()
            self._owner = tab
            self._tell(tab, "This tab edits now", "")

        self.perform(take)

    def _complain(self, error: Exception) -> None:
        said = _FOLDS.sub(r"space would fold; \1", plain(str(error)))
        self._said = f"⚠ {said}"

    def _failed(self, error: Exception) -> None:
        """What should not happen is said without its trace; the last good picture stays."""
        self._report(error)
        self._complain(PcoreError(f"{type(error).__name__}: see the terminal"))

    def _tell(self, tab: int, title: str, text: str) -> None:
        viewport = self._viewports.get(tab)
        if viewport is not None:
            viewport.client.add_notification(title, text, auto_close_seconds=6)
