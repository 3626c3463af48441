"""Programs in processes of their own without importing torch each: one that has, forks them."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

LOADED = ("pcore.cli.train", "pcore.cli.finetune", "pcore.asset.training")
"""What takes its time to be imported."""


class Forked:
    """Starts programs, one after the other, with one thread each."""

    def __init__(self) -> None:
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
        self.server = subprocess.Popen(
            [sys.executable, __file__],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
        )
        self.last: Child | None = None

    def start(self, code: str, *words: str, said: Path) -> Child:
        """Run code with these arguments; what it prints goes into a file.

        What a test has left running is ended.
        """
        if self.last is not None:
            self.last.end()
        said.touch()
        job = {"code": code, "words": words, "said": str(said)}
        assert self.server.stdin is not None
        self.server.stdin.write(json.dumps(job).encode() + b"\n")
        self.last = Child(self.server.stdout, said)
        return self.last

    def end(self) -> None:
        if self.last is not None:
            self.last.end()
        self.server.kill()
        self.server.communicate()


@dataclass
class Child:
    """A program that was started: the next one begins when this one has ended."""

    told: Any
    said: Path
    code: int | None = None
    pid: int = field(init=False)

    def __post_init__(self) -> None:
        self.pid = int(self.told.readline())

    def poll(self) -> int | None:
        """Its exit code, negative of a signal; None while it runs."""
        if self.code is None and select.select([self.told], [], [], 0)[0]:
            self.code = int(self.told.readline())
        return self.code

    def wait(self, seconds: float = 600) -> int:
        """Return its exit code when it has ended."""
        if self.code is None:
            assert select.select([self.told], [], [], seconds)[0], "it did not end in time"
            self.code = int(self.told.readline())
        return self.code

    def end(self, how: signal.Signals | None = None, seconds: float = 60) -> int:
        """Send it a signal (default: SIGKILL), unless it has ended; return its exit code."""
        if self.poll() is None:
            with suppress(ProcessLookupError):  # It ended since.
                os.kill(self.pid, signal.SIGKILL if how is None else how)
        return self.wait(seconds)

    def says(self, text: str, times: int = 1, seconds: float = 200) -> None:
        """Wait until it has said something so often."""
        end = time.monotonic() + seconds
        while self.said.read_text().count(text) < times:
            assert self.poll() is None, self.said.read_text()
            assert time.monotonic() < end, "it did not happen in time"
            time.sleep(0.002)

    def says_line(self, begin: str) -> str:
        """Wait for a whole line that begins so; return it."""
        self.says(begin)
        while True:
            for line in self.said.read_text().splitlines(keepends=True):
                if line.startswith(begin) and line.endswith("\n"):
                    return line
            time.sleep(0.002)


def _serve() -> None:
    for name in LOADED:
        import_module(name)
    for line in sys.stdin:
        child = os.fork()
        if not child:
            _run(**json.loads(line))
        _tell(child)
        _tell(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))


def _tell(number: int) -> None:
    sys.stdout.write(f"{number}\n")
    sys.stdout.flush()


def _run(code: str, words: list[str], said: str) -> NoReturn:
    """Be the program, and end as `python -c` does."""
    file, nothing = os.open(said, os.O_WRONLY | os.O_APPEND), os.open(os.devnull, os.O_RDONLY)
    for here, there in ((nothing, 0), (file, 1), (file, 2)):
        os.dup2(here, there)
    # Shells let what they start in the background ignore Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.argv = ["-c", *words]
    exec(code, {"__name__": "__main__"})
    sys.exit()


if __name__ == "__main__":
    _serve()
