"""`pcore train`: options into settings, what is said before and after, for both kinds of object."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

from rich.console import Console

from pcore.asset.asset import Asset
from pcore.asset.training import train as make
from pcore.cli.console import say
from pcore.cli.losses import check_weights
from pcore.cli.minutes import Promise, check_promise, promised, say_duration
from pcore.cli.runtime import pick_device, prepare_torch
from pcore.cli.scenes import opened
from pcore.cli.sessions import show_result, trained_together
from pcore.cli.torchrun import is_first, refuse_ranks
from pcore.cli.train import TrainCommand
from pcore.cli.train_checks import EARLY, announce, check_shows, start_file, warn_of_start
from pcore.data.scene import Scene
from pcore.errors import InputError
from pcore.evaluation.findings import region_advice
from pcore.files.run_place import check_place
from pcore.training import presets
from pcore.training.config import PretrainConfig
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.gaussian_start import chosen_start

_NO_HULL = "images without alpha have no visual hull"
_STARTS = {
    "views": "before the cameras, where photos agree",
    "sparse": "at the points of the reconstruction and far away",
}


def train(command: TrainCommand, console: Console) -> None:
    """Train as the command says, together with the other processes that torchrun started.

    Only the first of them has the folder and says anything.
    """
    began = time.monotonic()
    config = train_config(command)
    prepare_torch(command.threads)
    device = pick_device(command.device)
    if is_first():
        check_place(command.output, resume=command.resume)  # Before the photos are read.
    scene = opened(command, console)
    masked = all(view.has_alpha for view in scene.split("train"))
    if isinstance(config, PretrainConfig):
        config = _fitting(command, config, scene, console, masked=masked)
    plan = f"{command.preset}, {config.steps:,} steps"
    if command.minutes is not None:
        refuse_ranks("--minutes")
        promise = Promise(minutes=command.minutes, began=began)
        scene, config, plan = promised(command, scene, config, device, promise)
    _say_before(command, scene, config, f"{plan} on {device}", console, masked=masked)
    if command.minutes is None:
        say_duration(console, scene, config, device)
    asset = _trained(command, scene, config, device, console)
    if asset is not None:
        if config.steps >= EARLY:
            check_shows(asset, scene)
        show_result(console, asset)
        if isinstance(config, GaussianConfig) and not masked:
            say(console, region_advice(scene.lower, scene.upper))


def _say_before(
    command: TrainCommand,
    scene: Scene,
    config: PretrainConfig | GaussianConfig,
    plan: str,
    console: Console,
    *,
    masked: bool,
) -> None:
    """Say what is trained and where it starts, and what is odd about that."""
    start, otherwise = config.start, "grid"
    if isinstance(config, GaussianConfig):
        start, otherwise = chosen_start(scene, config.start), "views"
        plan = f"{'flat ' * command.flat}Gaussians, {plan}"
    if start != "sparse":
        warn_of_start(scene, start, console, otherwise=otherwise)
    announce(console, scene, plan)
    if start in _STARTS:
        why = "photos from one side leave the hull open" if masked else _NO_HULL
        say(console, f"{why}: Gaussians start {_STARTS[start]}")


def _trained(
    command: TrainCommand,
    scene: Scene,
    config: PretrainConfig | GaussianConfig,
    device: str,
    console: Console,
) -> Asset | None:
    """Train with progress shown; only the first process has the result, the others get None."""
    return trained_together(
        command,
        console,
        lambda folder, listener, options: make(
            scene, config, folder=folder, listener=listener, device=device, options=options
        ),
        output=command.output,
        preset=command.preset,
        device=device,
        scene=scene,
        given={"settings": config},
    )


def train_config(command: TrainCommand) -> PretrainConfig | GaussianConfig:
    """Return the preset with what the command changes.

    Raises:
        InputError: options that do not go together, or wrong values.
    """
    _refuse_foreign(command)
    check_promise(command)
    changes: dict[str, Any] = {"seed": command.seed, **command.losses.changes()}
    for name in ("steps", "points", "background", "origin", "exposure"):
        if getattr(command, name) is not None:
            changes[name] = getattr(command, name)
    if command.init in ("hull", "grid", *_STARTS):
        changes["start"] = command.init
    elif command.init is not None:
        changes["start"] = start_file(command.init, command.points)
    if command.model == "papr":
        networks = presets.preset(command.preset)
        if command.patches is not None:
            changes["patch"] = replace(networks.patch, views=command.patches)
        return replace(networks, **changes)
    gaussians = presets.gaussian_preset(command.preset)
    if command.patches is not None:
        changes["views"] = command.patches
    if command.flat:
        changes["footprint"] = replace(gaussians.footprint, flat=True)
    return replace(gaussians, **changes)


def _refuse_foreign(command: TrainCommand) -> None:
    """Raise InputError for options that only the other kind of object has."""
    losses = command.losses.changes()
    if command.model == "papr":
        own, other, instead = "PAPR", "Gaussians have", "gaussians"
        foreign = {"--flat": command.flat, f"--init {command.init}": command.init in _STARTS}
    else:
        own, other, instead = "Gaussians", "PAPR has", "papr"
        foreign = {
            "--origin": command.origin is not None,
            "--no-compile": command.no_compile,
            **{f"--{name.replace('_', '-')}": True for name in losses},
            "--init grid": command.init == "grid",
        }
    given = [name for name, is_given in foreign.items() if is_given]
    if given:
        raise InputError(
            f"{', '.join(given)}: expected options of {own} (--model {command.model}), got some "
            f"that only {other}; leave them out, or train with --model {instead}"
        )


def _fitting(
    command: TrainCommand, config: PretrainConfig, scene: Scene, console: Console, *, masked: bool
) -> PretrainConfig:
    """Settings of PAPR that fit the photos; errors as `train`."""
    if command.init is None and not masked:
        say(
            console,
            f"{_NO_HULL}: points start on a grid. PAPR learns little before a background (7 to 13 "
            "dB of two sets of photos): add --masks auto, or train with --model gaussians",
        )
        config = replace(config, start="grid")
    command.losses.check(config, scene.split("train"))
    check_weights(config.lpips_weight, config.lpips_trunk)
    return config
