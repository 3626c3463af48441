"""`pcore train SCENE --model gaussians`: 3D Gaussians from photos."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

from pcore.cli.minutes import Promise, promised, say_duration
from pcore.cli.torchrun import is_first
from pcore.cli.train import TrainCommand, opened, trained
from pcore.cli.train_checks import EARLY, announce, check_shows, start_file, warn_of_start
from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.training.gaussian_config import GaussianConfig

_NO_HULL = "images without alpha have no visual hull"
_STARTS = {
    "views": "before the cameras, where photos agree",
    "sparse": "at the points of the reconstruction and far away",
}


def train_gaussians(command: TrainCommand, console: Console) -> None:
    """Train as the command line says.

    Raises:
        InputError: an option that Gaussians do not have.
        PcoreError: as `fit_gaussians` and the run folder.
    """
    from pcore.cli.runtime import pick_device, prepare_torch
    from pcore.cli.sessions import show_result
    from pcore.cli.torchrun import refuse_ranks
    from pcore.evaluation.findings import region_advice
    from pcore.files.run_place import check_place
    from pcore.training.gaussian_start import chosen_start

    began = time.monotonic()
    prepare_torch(command.threads)
    device = pick_device(command.device)
    if is_first():
        check_place(command.output, resume=command.resume)  # Before the photos are read.
    config = _config(command)
    scene = opened(command, console)
    plan = f"{command.preset}, {config.steps:,} steps"
    if command.minutes is not None:
        refuse_ranks("--minutes")
        promise = Promise(minutes=command.minutes, began=began)
        scene, config, plan = promised(command, scene, config, device, promise)
    start = chosen_start(scene, config.start)
    if start != "sparse":
        warn_of_start(scene, start, console, otherwise="views")
    announce(console, scene, f"{'flat ' * command.flat}Gaussians, {plan} on {device}")
    if command.minutes is None:
        say_duration(console, scene, config, device)
    masked = all(view.has_alpha for view in scene.split("train"))
    if start in _STARTS:
        why = "photos from one side leave the hull open" if masked else _NO_HULL
        console.print(Text(f"{why}: Gaussians start {_STARTS[start]}"), soft_wrap=True)
    asset = trained(command, scene, config, device, console)
    if asset is None:
        return
    if config.steps >= EARLY:
        check_shows(asset, scene)
    show_result(console, asset)
    if not masked:
        console.print(Text(region_advice(scene.lower, scene.upper)), soft_wrap=True)


def _config(command: TrainCommand) -> GaussianConfig:
    """Return the preset with what the command changes."""
    from pcore.training.presets import gaussian_preset

    foreign = {
        "--origin": command.origin,
        "--no-compile": command.no_compile or None,
    }
    foreign |= {f"--{name.replace('_', '-')}": x for name, x in command.losses.changes().items()}
    given = [name for name, value in foreign.items() if value is not None]
    if command.init == "grid":
        given.append("--init grid")
    if given:
        raise InputError(
            f"{', '.join(given)}: expected options of Gaussians (--model gaussians), got some that "
            "only PAPR has; leave them out, or train with --model papr"
        )
    changes: dict[str, Any] = {"seed": command.seed}
    if command.patches is not None:
        changes["views"] = command.patches
    for name in ("steps", "points", "background", "exposure"):
        if getattr(command, name) is not None:
            changes[name] = getattr(command, name)
    preset = gaussian_preset(command.preset)
    if command.flat:
        changes["footprint"] = replace(preset.footprint, flat=True)
    if command.init in ("hull", "sparse", "views"):
        changes["start"] = command.init
    elif command.init is not None:
        changes["start"] = start_file(command.init, command.points)
    return replace(preset, **changes)
