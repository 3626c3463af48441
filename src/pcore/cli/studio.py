"""`pcore studio RUN`: edit a run by hand, in the browser."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
import threading
import traceback
from contextlib import ExitStack, closing
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.console import say
from pcore.cli.options import Count, optional
from pcore.cli.runtime import DeviceName, pick_device, prepare_torch
from pcore.errors import InputError
from pcore.studio.guard import Guard
from pcore.studio.ports import check_port

if TYPE_CHECKING:
    from pcore.studio.studio import Studio

_FOLDER = "studio"
_LONGEST = 15.0
"""Seconds that closing a page may take: longer than all that it waits for."""


@dataclass(frozen=True, kw_only=True)
class StudioCommand:
    """Take an object in your hand: drag it, see it, undo it, key it, film it."""

    run_or_file: Annotated[Positional[Path | None], optional("RUN")] = None
    """Folder of a run; not needed with --demo."""

    edit: Annotated[Path | None, optional("FILE")] = None
    """Edit file (JSON) to open and to save; default: studio/edit.json in the run."""

    demo: bool = False
    """Open a small object that comes along, with the first steps; nothing is trained."""

    host: Annotated[str, arg(metavar="NAME")] = "127.0.0.1"
    """Address to listen at; only this machine without it. Whoever has the printed address may
    edit."""

    port: Annotated[int, arg(metavar="N")] = 8123
    """Port to listen at."""

    device: DeviceName = "auto"
    """Where to draw; auto takes a GPU where there is one."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Do it, and end the process; raises PcoreError subclasses for what the user can mend."""
        with ExitStack() as stack:
            studio(self, Console(), stack)
        # All is written. A thread that compiles a kernel cannot be stopped, and the interpreter
        # takes seconds to clear its modules on a busy machine: nobody waits for either.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)


def studio(command: StudioCommand, console: Console, stack: ExitStack) -> None:
    """Open the page and wait until Ctrl-C."""
    from pcore.studio.server import require_viser

    if (command.run_or_file is None) != command.demo:
        raise InputError("expected the folder of a run, or --demo, and not both")
    require_viser()
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda number, frame: ended.set())
    last = threading.Timer(_LONGEST, os._exit, (0,))
    last.daemon = True
    stack.callback(last.cancel)
    page = stack.enter_context(closing(_opened(command, stack)))
    say(console, page.url, *_tunnel(command), _ending(command))
    try:
        ended.wait()
    except KeyboardInterrupt:
        say(console, "")
    # A tab or a thread that does not let go must not keep the program after Ctrl-C.
    last.start()


def _opened(command: StudioCommand, stack: ExitStack) -> Studio:
    from pcore.asset.saving import load
    from pcore.studio.outputs import Outputs
    from pcore.studio.studio import Studio

    check_port(command.host, command.port)
    prepare_torch(command.threads)
    run = _demo(stack) if command.run_or_file is None else command.run_or_file
    asset = load(run, device=pick_device(command.device))
    folder = (run if run.is_dir() else run.parent) / _FOLDER
    outputs = Outputs(folder=folder, edit=command.edit or folder / "edit.json", run=run)
    guard = Guard(host=command.host, port=command.port)
    title = "demo" if command.demo else run.resolve().name
    # What should not happen stands in the terminal; the page shows no trace.
    report = traceback.print_exception
    return Studio(asset, guard, outputs, title=title, tour=command.demo, report=report)


def _demo(stack: ExitStack) -> Path:
    """A copy of the object that comes along, which is gone with the page."""
    scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="pcore-studio-")))
    with as_file(files("pcore.studio").joinpath("demo_run")) as source:
        shutil.copytree(source, scratch / "demo")
    return scratch / "demo"


def _ending(command: StudioCommand) -> str:
    """What becomes of the work at the end."""
    if command.demo and command.edit is None:
        return (
            "Ctrl-C ends; the demo and all that it writes is gone then, unless --edit names a file"
        )
    if command.demo:
        return f"Ctrl-C ends; of the demo only what is saved in {command.edit} stays"
    return "Ctrl-C ends; what is not saved is kept"


def _tunnel(command: StudioCommand) -> list[str]:
    port = command.port
    return [f"from another machine: ssh -L {port}:127.0.0.1:{port} THIS_MACHINE, the same address"]
