"""Ctrl-C ends the program whatever its threads do, and keeps the edits."""

import signal
from pathlib import Path

import pytest
from page import kept
from tests.forked import Forked

pytest.importorskip("viser", reason="the extra studio is not installed")

_SERVER = """
import atexit, sys, time
from pcore.cli.main import main
from pcore.studio.studio import Studio

def rest(self, cancelled):
    # As a picture whose kernel is compiled: it hears of no wish to end.
    for _ in range(2):  # The second autosave waits for its turn.
        self.editor.session.do({"type": "twist", "axis": "z", "angle_deg": 20})
        self.files.autosave()
    print("busy", flush=True)
    time.sleep(300)
    yield

Studio._rest = rest
atexit.register(time.sleep, 300)
sys.exit(main(["studio", sys.argv[1], "--port", sys.argv[2]]))
"""


@pytest.mark.timeout(120)
def test_a_thread_that_hears_nothing_does_not_keep_the_program(
    run: Path, free_port: int, forked: Forked
) -> None:
    server = forked.start(_SERVER, str(run), str(free_port), said=run.parent / "said.txt")
    try:
        server.says("Ctrl-C")
        server.says("busy\n")
        assert server.end(signal.SIGINT) == 0
        assert len(kept(run)["edits"]) == 2
    finally:
        server.end()
