"""A command of a trial in several processes, as torchrun starts them: they end with the trial."""

from __future__ import annotations

import ctypes
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterable, Sequence

from pcore.errors import TrainingError

TORCHRUN = ("torchrun", "--standalone", "--nproc-per-node")
_REASON = re.compile(r"(?:\[rank\d+\]: *)?[\w.]*Error: (.+)")
"""Our messages, which are not wrapped in a file or pipe, and the end of a traceback."""
_DIES_WITH_PARENT = 1
"""PR_SET_PDEATHSIG of Linux's prctl."""


def run_together(words: Sequence[str]) -> None:
    """Run a command that starts several processes, and pass on what they print.

    Args:
        words: of `process_words`.
    """
    lines: list[str] = []
    pipe, joined = subprocess.PIPE, subprocess.STDOUT
    with subprocess.Popen(words, stdout=pipe, stderr=joined, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            print(line, end="")
            lines.append(line)
    if process.returncode:
        raise TrainingError(
            f"its processes ended with code {process.returncode}: {reason_in(lines)}"
        )


def reason_in(lines: Iterable[str]) -> str:
    """Why a command of ours failed, by what it printed; torchrun says more of its own after it."""
    found = [one[1] for line in lines if (one := _REASON.match(line.rstrip()))]
    # Of a chain of tracebacks the last is what ended it; those before are its causes.
    return found[-1] if found else "no message"


def main() -> None:
    """Start `COUNT MODULE WORD...` by torchrun, until this process or its parent ends."""
    if sys.platform == "linux":
        # A worker of Ray that is killed cannot end what it started.
        ctypes.CDLL(None).prctl(_DIES_WITH_PARENT, signal.SIGTERM)
    from torch.distributed.run import main as torchrun

    os.environ.setdefault("OMP_NUM_THREADS", "1")  # torchrun would say at length that it does so.
    count, *command = sys.argv[1:]
    torchrun([*TORCHRUN[1:], count, "-m", *command])


if __name__ == "__main__":
    main()
