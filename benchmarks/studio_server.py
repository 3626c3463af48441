"""`python -m benchmarks.studio_server COMMANDS`: a page's server, edited by a script.

Prints JSON: processor seconds until the first picture, megabytes of memory, and by what share it
grew from a tenth of the commands to the last.
"""

from __future__ import annotations

import argparse
import json
import random
import socket
import time
from contextlib import closing
from importlib.resources import as_file, files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

_OFTEN, _EVERY, _SELDOM = 10, 20, 500
"""Commands between two cards in the panel, looks at the splats, and pictures with an autosave."""
_MOST = 8
"""Edits in the stack."""
_EDITS: tuple[dict[str, Any], ...] = (
    {"type": "twist", "axis": "z", "angle_deg": 10},
    {"type": "bend", "axis": "x", "angle_deg": 8},
    {"type": "scale", "factor": 1.05},
    {"type": "rigid", "translation": [0, 0, 0.05]},
)


def megabytes() -> float:
    """Memory that this process has now."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    raise OSError("no VmRSS")


def main(commands: int) -> dict[str, float]:
    """Open the page of the object that comes along, edit it, and say what that took."""
    import torch

    import pcore
    from pcore.studio.guard import Guard
    from pcore.studio.outputs import Outputs
    from pcore.studio.studio import Studio

    torch.set_num_threads(1)
    with TemporaryDirectory() as scratch, as_file(files("pcore.studio") / "demo_run") as run:
        outputs = Outputs(folder=Path(scratch), edit=Path(scratch) / "edit.json", run=run)
        guard = Guard(host="127.0.0.1", port=_free_port())
        with closing(Studio(pcore.load(run), guard, outputs, title="demo")) as page:
            draw = _Drawing(page)
            draw.rest()
            start = time.process_time()
            before = after = 0.0
            hand = _Hand(page)
            for number in range(commands):
                hand.work(number)
                if number % _OFTEN == 0:
                    draw.card(number // _OFTEN)
                if number % _EVERY == 0:
                    draw.move()
                if number % _SELDOM == 0:
                    draw.rest()
                    page.files.autosave()
                if number == commands // 10:
                    before = megabytes()
            after = megabytes()
    return {"start": start, "megabytes": after, "growth": after / before - 1.0}


class _Drawing:
    """What the page's worker draws, without a tab to send it to."""

    def __init__(self, page: Any) -> None:
        from pcore.geometry.orbit import orbit_around

        self._page = page
        points = page.editor.asset.points
        self._camera = orbit_around(points, size=(400, 400))[0]

    def card(self, number: int) -> None:
        editor = self._page.editor
        editor.select(number % len(editor.session.stack.edits))
        self._page._refresh()

    def move(self) -> None:
        eye = self._camera.center
        self._page.frame.buffer(self._page.drawer.splats(self._page.editor.state, eye))

    def rest(self) -> None:
        drawer = self._page.drawer
        posed = drawer.posed(self._page.editor.state, still=True)
        for _ in drawer.pictures(posed, self._camera, lambda: False):
            pass


class _Hand:
    """A person who adds edits, drags their numbers, takes some back, and never has many."""

    def __init__(self, page: Any) -> None:
        self._session, self._draw = page.editor.session, random.Random(0)

    def work(self, number: int) -> None:
        session, draw = self._session, self._draw
        edits = len(session.stack.edits)
        if edits < 3:
            session.do(draw.choice(_EDITS))
        elif edits > _MOST:
            session.remove(draw.randrange(edits))
        elif number % 10 == 9:
            for _ in range(draw.randrange(1, 4)):
                if session.can_undo:
                    session.undo()
        else:
            index = draw.randrange(edits)
            edit = session.state.script.edits[index]
            session.preview(edit, at=index, frames="quick")
            session.replace(index, draw.choice(_EDITS), merge=draw.choice([None, "drag"]))


def _free_port() -> int:
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commands", type=int, help="how many edits")
    print(json.dumps(main(parser.parse_args().commands)))
