"""`pcore view RUN`: look at a run, also edited or animated, in the browser or as one file."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.console import say
from pcore.cli.light import LightChoice
from pcore.cli.options import Count, Number, optional
from pcore.cli.runtime import prepare_torch
from pcore.data.whole_file import write_whole
from pcore.errors import InputError
from pcore.studio.guard import Guard
from pcore.studio.ports import check_port

if TYPE_CHECKING:
    from pcore.asset.asset import Asset, Posed
    from pcore.studio.viewer_page import Page

_LEAST_MEGABYTES = 0.2


@dataclass(frozen=True, kw_only=True)
class ViewCommand:
    """Look at a run as splats, from all sides; an edit file with keyframes plays."""

    run_or_file: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of a run, or a model.safetensors."""

    edit: Annotated[Path | None, optional("FILE")] = None
    """Edit file (JSON) to apply first."""

    time: Number = None
    """For an edit file with keyframes: the one time to show; default: all of them, as a film."""

    html: Annotated[Path | None, optional("FILE")] = None
    """Write one HTML file that works without a server and without a network, and end; default:
    serve that page on this machine until Ctrl-C."""

    megabytes: Annotated[float, arg(metavar="X")] = 5.0
    """Largest size of the page; what does not fit is left out, and said."""

    frames: Annotated[int, arg(metavar="N")] = 24
    """Moments that are kept of a film; between them motion is steady."""

    seconds: Annotated[float, arg(metavar="X")] = 4.0
    """How long a film plays."""

    light: LightChoice = None
    """still: the light and its shadows stay where they are; baked: every point keeps the brightness
    of the photos. Default: still where the run has a light (`pcore light`), else baked."""

    host: Annotated[str, arg(metavar="NAME")] = "127.0.0.1"
    """Address to serve at; other than this machine's own, anybody who has the printed address can
    look."""

    port: Annotated[int, arg(metavar="N")] = 8123
    """Port to serve at."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Do it; raises PcoreError subclasses for what the user can mend."""
        view(self, Console())


def view(command: ViewCommand, console: Console) -> None:
    """Make the page, and write or serve it."""
    from pcore.asset.saving import load
    from pcore.studio.viewer_page import page_server

    _check(command)
    if command.html is None:
        check_port(command.host, command.port)
    prepare_torch(command.threads)
    page = _page(load(command.run_or_file), command)
    notes = [f"  note: {note}" for note in page.notes]
    if command.html is not None:
        write_whole(command.html, page.content, "page")
        size = len(page.content) / 1e6
        say(console, f"{command.html}: {size:.1f} MB, opens in any browser", *notes)
        return
    guard = Guard(host=command.host, port=command.port)
    with page_server(guard, page.content) as server, suppress(KeyboardInterrupt):
        say(console, guard.url, *notes, "Ctrl-C ends")
        server.serve_forever()


def _check(command: ViewCommand) -> None:
    if command.frames < 2:
        raise InputError(f"--frames: expected at least 2, got {command.frames}")
    if not 0 < command.seconds < float("inf"):
        raise InputError(f"--seconds: expected a positive number, got {command.seconds}")
    if not _LEAST_MEGABYTES <= command.megabytes < float("inf"):
        raise InputError(
            f"--megabytes: expected at least {_LEAST_MEGABYTES}, got {command.megabytes}"
        )


def _page(asset: Asset, command: ViewCommand) -> Page:
    from pcore.studio.recording import record
    from pcore.studio.viewer_page import viewer_page

    frames = _frames(asset, command)
    page = viewer_page(
        record(asset, frames),
        title=command.run_or_file.resolve().name,
        seconds=command.seconds,
        limit=int(command.megabytes * 1e6),
    )
    odd = dict.fromkeys(note for posed in frames for note in posed.notes)
    return replace(page, notes=(*odd, *page.notes))


def _frames(asset: Asset, command: ViewCommand) -> list[Posed]:
    from pcore.editing.animation import load_animation

    if command.edit is None:
        return [asset.pose()]
    animation = load_animation(command.edit)
    times = [animation.start if command.time is None else command.time]
    if command.time is None and animation.end > animation.start:
        times = animation.times(command.frames)
    return [asset.pose(animation, time=time, light=command.light) for time in times]
