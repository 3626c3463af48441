"""A training as people see it: a bar, what is odd, the result and what comes next."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

if TYPE_CHECKING:
    from pathlib import Path

    from pcore.asset.asset import Asset
    from pcore.asset.run_options import RunOptions
    from pcore.cli.finetune import FinetuneCommand
    from pcore.cli.train import TrainCommand
    from pcore.training.events import Listener


@contextmanager
def shown_training(console: Console) -> Generator[tuple[Listener, Callable[[str], None]]]:
    """Give a listener that shows a training, and what prints its notes."""
    from pcore.cli.console import ProgressDisplay

    def note(text: str) -> None:
        console.print(Text(text), soft_wrap=True)

    with ProgressDisplay(console) as display:
        yield display, note


def trained_with(
    command: TrainCommand | FinetuneCommand,
    console: Console,
    output: Path,
    preset: str,
    make: Callable[[Listener, RunOptions], Asset],
) -> Asset:
    """Train with progress shown; say what the light is, unless the run was finished before."""
    from pcore.asset.run_options import RunOptions
    from pcore.cli.light import show_light
    from pcore.files.run_record import finished

    done = command.resume and finished(output)
    with shown_training(console) as (listener, note):
        options = RunOptions(
            resume=command.resume,
            tensorboard=not command.no_tensorboard,
            compiled=not command.no_compile,
            preset=preset,
            note=note,
        )
        asset = make(listener, options)
    if not done:
        show_light(asset, console)
    return asset


def show_result(console: Console, asset: Asset) -> None:
    """Say how good a run became, where it is, and what can be done with it."""
    path, validation = asset.path, asset.record.notes.get("validation") or {}
    psnr = validation.get("kept_psnr" if "kept_step" in validation else "psnr")
    quality = "" if psnr is None else f": {psnr:.2f} dB on held-out training views"
    console.print(Text(f"{path}{quality}"), soft_wrap=True)
    # Measured: with aware rays and a light, fine-tuning costs more than it brings
    # (docs/research/quality.md), so that it is no step on the way.
    console.print(Text(f"next: pcore render {path} --edit edit.json"), soft_wrap=True)
    if asset.record.stage == "pretrain" and asset.record.config.get("model") != "gaussians":
        text = f"the paper's method, for plain rays: pcore finetune {path}"
        console.print(Text(text), soft_wrap=True)
