"""A training as people see it: a bar, what is odd, the result and what comes next."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from rich.console import Console

from pcore.asset.asset import Asset
from pcore.cli.console import ProgressDisplay, say
from pcore.cli.finetune import FinetuneCommand
from pcore.cli.light import show_light
from pcore.cli.torchrun import joined_ranks
from pcore.cli.train import TrainCommand
from pcore.data.scene import Scene
from pcore.files.provenance import pcore_version
from pcore.files.run_record import finished
from pcore.training.events import Listener, silent
from pcore.training.in_folder import RunOptions

Make = Callable[[Path | None, Listener, RunOptions], Asset]


@contextmanager
def shown_training(console: Console) -> Generator[tuple[Listener, Callable[[str], None]]]:
    """Give a listener that shows a training, and what prints its notes."""
    with ProgressDisplay(console) as display:
        yield display, partial(say, console)


def trained_together(
    command: TrainCommand | FinetuneCommand,
    console: Console,
    make: Make,
    *,
    output: Path,
    preset: str,
    device: str,
    scene: Scene,
    given: Mapping[str, object],
) -> Asset | None:
    """Train or fine-tune, together with the other processes that torchrun started.

    Args:
        command: says whether to resume, and what is written besides.
        console: of the first process.
        make: trains in a folder or, for None, in memory.
        output: folder of the run.
        preset: name of the settings.
        device: see `joined_ranks`.
        scene: whose photos are learned from.
        given: what all processes must have been given alike, by what it is called.

    Returns:
        The result in the first process, the only one that has the folder; None in the others.
    """
    with joined_ranks(device) as ranks:
        views = [
            (view.name, view.camera.width, view.camera.height) for view in scene.split("train")
        ]
        ranks.agree({"version of pcore": pcore_version(), **given, "photos": views})
        done = ranks.from_first(command.resume and finished(output))
        if ranks.rank == 0:
            return _trained(command, console, make, output, preset, done=done)
        if not done:
            make(None, silent, RunOptions(light=False, compiled=not command.no_compile))
    return None


def _trained(
    command: TrainCommand | FinetuneCommand,
    console: Console,
    make: Make,
    output: Path,
    preset: str,
    *,
    done: bool,
) -> Asset:
    """Train with progress shown; say what the light is, unless the run was finished before."""
    with shown_training(console) as (listener, note):
        options = RunOptions(
            resume=command.resume,
            tensorboard=not command.no_tensorboard,
            compiled=not command.no_compile,
            preset=preset,
            note=note,
        )
        asset = make(output, listener, options)
    if not done:
        show_light(asset, console)
    return asset


def show_result(console: Console, asset: Asset) -> None:
    """Say how good a run became, where it is, and what can be done with it."""
    path, validation = asset.path, asset.record.notes.get("validation") or {}
    psnr = validation.get("kept_psnr" if "kept_step" in validation else "psnr")
    quality = "" if psnr is None else f": {psnr:.2f} dB on held-out training views"
    joined = asset.record.config.get("gaussians", {}).get("held_out_until") is not None
    if psnr is not None and joined and validation["step"] < asset.record.notes["step"]:
        quality += f" at step {validation['step']}; it has learned from them since"
    say(console, f"{path}{quality}")
    # Measured: with aware rays and a light, fine-tuning costs more than it brings
    # (docs/research/quality.md), so that it is no step on the way.
    edit, look = (shlex.join(["pcore", verb, str(path)]) for verb in ("studio", "render"))
    say(console, f"next: {edit} to edit it by hand, {look} for an orbit")
    if asset.record.stage == "pretrain" and asset.record.config.get("model") != "gaussians":
        text = f"the paper's method, for plain rays: pcore finetune {path}"
        say(console, text)
