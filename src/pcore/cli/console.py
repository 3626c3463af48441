"""What people see: lines, bars, progress of a training, errors in one sentence, exit codes."""

from __future__ import annotations

import errno
import os
import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from pcore.cli.torchrun import is_first
from pcore.demo.machine import clock
from pcore.errors import PcoreError

if TYPE_CHECKING:
    from pcore.training.events import BudgetReport, Event, StepReport

EXIT_ERROR = 2
EXIT_INTERRUPTED = 130
_LINE_SECONDS = 15.0
# Errors of the machine, not of pcore: a traceback would not help anybody.
_DISK = {errno.ENOSPC, errno.EROFS, errno.EACCES, errno.EPERM, errno.EDQUOT, errno.EIO, errno.EFBIG}
_PLACE = {errno.ENOTDIR, errno.ENAMETOOLONG, errno.EEXIST}
_ENVIRONMENT = _DISK | _PLACE


def say(console: Console, *lines: str | Text, style: str = "") -> None:
    """Print lines as they are.

    No markup, since messages quote what users wrote, brackets and all. No wrapping: a path broken
    in two cannot be copied.
    """
    for line in lines:
        console.print(Text(line, style) if isinstance(line, str) else line, soft_wrap=True)


def bar(console: Console) -> Progress:
    """A bar with how many are done and how long the rest takes; nothing without a terminal."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal,
    )


@contextmanager
def counting(console: Console, title: str) -> Generator[Callable[[int, int], None]]:
    """Give a function (done, total) that moves a bar; one line at the end without a terminal."""
    progress = bar(console)
    task = progress.add_task(title, total=None)
    last = [0]

    def tell(done: int, total: int) -> None:
        last[0] = done
        progress.update(task, completed=done, total=total)

    with progress:
        yield tell
    if not console.is_terminal and last[0]:
        say(console, f"{title}: {last[0]}")


def guarded(action: Callable[[], None]) -> int:
    """Run a command and return the exit code of the process.

    An error that pcore raises on purpose, and a full or read-only disk, becomes one message on
    stderr and code 2; Ctrl-C becomes code 130. With PCORE_DEBUG=1 errors keep their traceback.
    """
    debug = os.environ.get("PCORE_DEBUG") == "1"
    try:
        action()
    except PcoreError as error:
        if debug:
            raise
        return _complain("Error", str(error))
    except KeyboardInterrupt as stop:
        if is_first():  # Of several processes one saves, and says so.
            _complain("Interrupted", str(stop) or "nothing more was written")
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # `pcore info RUN | head`: nobody reads on. Python would complain again while it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if debug or error.errno not in _ENVIRONMENT:
            raise
        where = f"{error.filename}: " if error.filename else ""
        return _complain(
            "Error",
            f"{where}{error.strerror}; files are replaced whole, what was complete before is "
            "undamaged; free space or choose a writable place, and try again",
        )
    return 0


def _complain(title: str, message: str) -> int:
    say(Console(stderr=True), Text.assemble((f"{title}: ", "bold red"), message))
    return EXIT_ERROR


class ProgressDisplay:
    """Listener that shows a training: a bar in a terminal, a line now and then elsewhere.

    Use it in a `with` statement.
    """

    def __init__(
        self,
        console: Console | None = None,
        *,
        seconds_between_lines: float = _LINE_SECONDS,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._console = console or Console()
        self._between = seconds_between_lines
        self._now = now
        self._last: float | None = None
        self._tasks: dict[str, TaskID] = {}
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[figures]}"),
            console=self._console,
            disable=not self._console.is_terminal,
        )

    def __call__(self, event: Event) -> None:
        """Show one event."""
        from pcore.training.events import (
            BudgetReport,
            StepReport,
            Stopped,
            SurfaceReport,
            ValidationReport,
        )

        if isinstance(event, StepReport):
            self._step(event)
        elif isinstance(event, ValidationReport):
            best = ", the best so far" if event.best else ""
            best = best if event.accepted else ", a view lost more than the budget allows"
            then = "; from here on they are learned from as well" if event.learned_next else ""
            say(
                self._console,
                f"{event.stage} {event.step}: held-out views {event.psnr:.2f} dB "
                f"(mean of {event.views}){best}{then}",
            )
        elif isinstance(event, BudgetReport):
            say(self._console, f"{event.stage} {event.step}: {_trade(event)}")
        elif isinstance(event, SurfaceReport):
            say(self._console, f"{event.stage}: surface and light from {event.views} views")
        elif isinstance(event, Stopped):
            message = f": {event.message}" if event.message else ""
            say(self._console, f"{event.stage} {event.reason} at step {event.step}{message}")

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._progress.stop()

    def _step(self, event: StepReport) -> None:
        if self._console.is_terminal:
            if event.stage not in self._tasks:
                self._tasks[event.stage] = self._progress.add_task(
                    event.stage, total=event.steps, figures=""
                )
            self._progress.update(
                self._tasks[event.stage], completed=event.step, figures=_figures(event)
            )
            return
        now, last = self._now(), self._last
        if last is None or now - last >= self._between or event.step == event.steps:
            self._last = now
            say(self._console, f"{event.stage} {event.step}/{event.steps}  {_figures(event)}")


def _trade(event: BudgetReport) -> str:
    whole = event.share == 1
    took = "all" if whole else f"{event.share:.2f}"
    cost = f"held-out views {event.psnr - event.before:+.2f} dB"
    rest = "" if whole else f", all of it {event.after - event.before:+.2f} dB"
    return f"took {took} of the change: {cost} (budget {event.largest_loss:g} for each view{rest})"


def _figures(event: StepReport) -> str:
    parts = [f"loss {event.loss:.4g}"]
    if event.psnr is not None:
        parts.append(f"PSNR {event.psnr:.1f} dB")
    parts.append(f"{event.points:,} points")
    if event.seconds_left is not None:
        parts.append(f"{clock(event.seconds_left)} left")
    return "  ".join(parts)
