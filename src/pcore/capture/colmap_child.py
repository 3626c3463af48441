"""Another Python that runs COLMAP's library: told what to do, listened to, ended when it hangs.

COLMAP's library and Pillow crash one another in one process, and what hangs there ignores SIGTERM.
"""

from __future__ import annotations

import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pcore.errors import SceneError

Tell = Callable[[str], None]
"""Called with a line of progress."""
_SAID = "pcore: "
"""How lines of the child begin that are for the user."""


@dataclass(frozen=True, kw_only=True)
class Patience:
    """How long a reconstruction may take, seconds.

    Attributes:
        whole: all of it.
        silence: without a line of the child.
    """

    whole: float = 7200.0
    silence: float = 900.0


@dataclass(kw_only=True)
class _Watch:
    """Ends a child that takes too long, or says nothing for too long.

    Attributes:
        child: the process.
        patience: how long it may take.
        heard: time of its last line, seconds of the monotonic clock.
        late: why it was ended; empty while it was not.
    """

    child: subprocess.Popen[str]
    patience: Patience
    heard: float
    late: str = ""

    def __call__(self) -> None:
        """Look at the clock until the child ends."""
        began = self.heard
        while self.child.poll() is None:
            now = time.monotonic()
            if now - began > self.patience.whole:
                self.late = f"after {self.patience.whole:g} s"
            elif now - self.heard > self.patience.silence:
                self.late = f"after {self.patience.silence:g} s in which it said nothing"
            if self.late:
                self.child.kill()  # SIGTERM is not enough: a crashed COLMAP ignores it.
                return
            time.sleep(0.1)


def run_child(
    command: Sequence[str], tell: Tell, patience: Patience, where: str, purpose: str
) -> None:
    """Run a child to its end, or end it.

    Args:
        command: to run; lines of its output that begin with "pcore: " are told.
        tell: called with those lines.
        patience: how long it may take.
        where: the scene, the start of messages.
        purpose: what there is none of where it fails, such as "poses".

    Raises:
        SceneError: it hung, or crashed.
    """
    tail: deque[str] = deque(maxlen=8)
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        text=True,
        errors="replace",
    ) as child:
        watch = _Watch(child=child, patience=patience, heard=time.monotonic())
        threading.Thread(target=watch, daemon=True).start()
        try:
            assert child.stdout is not None, "it was asked for"
            for line in child.stdout:
                watch.heard = time.monotonic()
                if line.startswith(_SAID):
                    tell(line.removeprefix(_SAID).rstrip())
                else:
                    tail.append(line.rstrip())
            child.wait()
        except BaseException:
            child.kill()
            raise
    if watch.late:
        raise SceneError(
            f"scene {where}: COLMAP was ended {watch.late}; give fewer or smaller photos, or pose "
            "them with COLMAP itself and put the model into sparse/0"
        )
    if child.returncode != 0:
        said = " | ".join(line for line in tail if line)[-400:]
        raise SceneError(
            f"scene {where}: COLMAP ended with code {child.returncode} and found no {purpose}; it "
            f"said: {said or 'nothing'}"
        )
