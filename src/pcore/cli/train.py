"""`pcore train SCENE -o RUN`: learn Gaussians, or the points and networks of PAPR, from photos."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.losses import LossOptions, check_weights
from pcore.cli.minutes import Promise, promised, say_duration
from pcore.cli.options import Count, optional
from pcore.cli.runtime import DeviceName
from pcore.cli.torchrun import is_first
from pcore.cli.train_checks import EARLY, announce, check_shows, start_file, warn_of_start
from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.asset.asset import Asset
    from pcore.data.scene import Scene
    from pcore.training.config import PretrainConfig
    from pcore.training.gaussian_config import GaussianConfig


@dataclass(frozen=True, kw_only=True)
class TrainCommand:
    """Learn a scene from its training views; every tenth of them only validates.

    Test views are never looked at.
    """

    scene: Annotated[Positional[Path], arg(metavar="SCENE")]
    """Folder of the scene, in any layout that is known (NeRF-Synthetic, COLMAP, transforms.json,
    IDR, LLFF, NSVF), or of photos; see the guide "Own photos"."""

    output: Annotated[Path, arg(aliases=["-o"], metavar="RUN")]
    """Folder to make; new or empty, unless --resume."""

    model: Literal["gaussians", "papr"] = "gaussians"
    """gaussians: 3D Gaussians, minutes; papr: points and networks, the paper's object."""

    flat: bool = False
    """Flat Gaussians (2DGS): discs whose planes rays meet; on the CPU (gaussians)."""

    preset: Literal["tiny", "fast", "paper", "paper-lego"] = "tiny"
    """tiny: 2 CPU cores, minutes; fast: one GPU, not measured yet; paper: the original, hours;
    paper-lego: the original as it was set for its scene lego."""

    factor: Annotated[int, arg(metavar="N")] = 1
    """Down-scale images by this whole number (area mean)."""

    minutes: Annotated[float | None, optional("M")] = None
    """Time for all of it: chooses resolution, number of Gaussians or points, steps and schedule
    from the photos and the measured speed of this machine, and keeps to it within a fifth."""

    steps: Count = None
    """Optimiser steps; default: those of the preset."""

    points: Count = None
    """Points at the start; default: those of the preset."""

    origin: Annotated[Literal["camera", "reference"] | None, optional("{camera,reference}")] = None
    """Where rays begin for the networks: camera (the original) or reference (close
    before the object, whatever camera renders); default: that of the preset."""

    patches: Count = None
    """Patches of a step (gaussians: whole photos), whose loss is their mean; default: those of the
    preset. The processes that `torchrun` starts share them."""

    seed: Annotated[int, arg(metavar="N")] = 0
    """Seed of every random draw."""

    init: Annotated[str | None, optional("hull|grid|sparse|views|FILE")] = None
    """Where points start: hull (of the masks), grid (the original's; papr), sparse (points of the
    reconstruction that posed the photos, or triangulated now by their poses (COLMAP), and far ones;
    gaussians), views (where neighbouring
    photos agree, and far away; gaussians), or a PLY or NPY file. Default: hull; for images without
    alpha grid (papr), or sparse where there are such points, else views (gaussians)."""

    masks: Annotated[str | None, optional("auto|trained|none|FOLDER")] = None
    """Where photos show the object: auto (cut out of them now, needs OpenCV; where that fails as
    trained), trained (learn the whole room for one or two minutes and draw the object alone), a
    folder of masks, or none (learn the background too). Default: alpha, or masks that the scene
    brings."""

    box: Annotated[tuple[float, ...], arg(metavar="X Y Z X Y Z", help_behavior_hint="")] = ()
    """Lower and upper corner of the object in world units; default: found (`pcore check`)."""

    background: Annotated[
        Literal["white", "black", "random"] | None, optional("{white,black,random}")
    ] = None
    """Colour behind images with alpha; default: that of the preset (random; white for papr)."""

    exposure: Annotated[Literal["per-view"] | None, optional("{per-view}")] = None
    """per-view: learn an affine map of colours for every photo along, where exposure and white
    balance change from photo to photo. Default: photos are taken as they are."""

    losses: Annotated[LossOptions, arg(name="")] = field(default_factory=LossOptions)
    """Weights of the losses; default: those of the preset."""

    resume: bool = False
    """Go on exactly where the run in the output folder was interrupted."""

    no_tensorboard: bool = False
    """Do not write RUN/tensorboard, the curves for TensorBoard (they need the extra `log`)."""

    device: DeviceName = "auto"
    """Where to train; auto takes a GPU where there is one."""

    no_compile: bool = False
    """Do not compile the networks on a GPU (torch.compile): slower, but needs no compiler."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Train; raises PcoreError subclasses for what the user can mend."""
        if self.model == "gaussians":
            from pcore.cli.train_gaussians import train_gaussians

            train_gaussians(self, Console(quiet=not is_first()))
        else:
            train(self, Console(quiet=not is_first()))


def train(command: TrainCommand, console: Console) -> None:
    """Train as the command says, together with the other processes that torchrun started.

    Only the first of them has the folder and says anything.

    Raises:
        SceneError: the scene cannot be read.
        InputError: options that do not fit the scene, or an output folder in use.
        WeightsError: the preset asks for LPIPS weights that are missing.
        TrainingError: training diverged or cannot write, or nothing is to be seen at its end.
        KeyboardInterrupt: Ctrl-C, after saving.
    """
    from pcore.cli.runtime import pick_device, prepare_torch
    from pcore.cli.sessions import show_result
    from pcore.cli.torchrun import refuse_ranks
    from pcore.files.run_place import check_place

    began = time.monotonic()
    _refuse_foreign(command)
    prepare_torch(command.threads)
    device = pick_device(command.device)
    if is_first():
        check_place(command.output, resume=command.resume)  # Before the photos are read.
    scene = opened(command, console)
    config = _config(command, scene, console)
    command.losses.check(config, scene.split("train"))
    check_weights(config.lpips_weight, config.lpips_trunk)
    plan = f"{command.preset}, {config.steps:,} steps"
    if command.minutes is not None:
        refuse_ranks("--minutes")
        promise = Promise(minutes=command.minutes, began=began)
        scene, config, plan = promised(command, scene, config, device, promise)
    announce(console, scene, f"{plan} on {device}")
    if command.minutes is None:
        say_duration(console, scene, config, device)
    asset = trained(command, scene, config, device, console)
    if asset is None:
        return
    if config.steps >= EARLY:
        check_shows(asset, scene)
    show_result(console, asset)


def opened(command: TrainCommand, console: Console) -> Scene:
    """Open the scene with the masks that are asked for, and find its object.

    Raises:
        SceneError: the scene or a mask cannot be read.
        InputError: a bad box, or masks that cannot be found.
        DependencyError: automatic masks without OpenCV.
    """
    from pcore.cli.scenes import located_scene

    return located_scene(
        command.scene,
        factor=command.factor,
        masks=command.masks,
        box=command.box,
        made=command.output / "masks",
        console=console,
        points=command.init == "sparse",
    ).scene


def trained(
    command: TrainCommand,
    scene: Scene,
    config: PretrainConfig | GaussianConfig,
    device: str,
    console: Console,
) -> Asset | None:
    """Train with progress shown; only the first process has the result, the others get None."""
    from pcore.asset.training import train as make
    from pcore.cli.sessions import trained_together

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


def _refuse_foreign(command: TrainCommand) -> None:
    given = "--flat" if command.flat else f"--init {command.init}"
    if command.flat or command.init in ("sparse", "views"):
        raise InputError(
            f"{given}: expected an option of PAPR (--model papr), got one that only Gaussians "
            "have; leave it out, or train with --model gaussians"
        )


def _config(command: TrainCommand, scene: Scene, console: Console) -> PretrainConfig:
    """Return the preset with what the command changes."""
    from pcore.training.presets import preset

    changes: dict[str, Any] = {"seed": command.seed, **command.losses.changes()}
    for name in ("steps", "points", "background", "origin", "exposure"):
        if getattr(command, name) is not None:
            changes[name] = getattr(command, name)
    if command.init in ("hull", "grid"):
        changes["start"] = command.init
    elif command.init is not None:
        changes["start"] = start_file(command.init, command.points)
    elif not all(view.has_alpha for view in scene.split("train")):
        console.print(
            "images without alpha have no visual hull: points start on a grid. PAPR learns little "
            "before a background (7 to 13 dB of two sets of photos): add --masks auto, or train "
            "with --model gaussians",
            soft_wrap=True,
        )
        changes["start"] = "grid"
    start = preset(command.preset)
    if command.patches is not None:
        changes["patch"] = replace(start.patch, views=command.patches)
    config = replace(start, **changes)
    warn_of_start(scene, config.start, console, otherwise="grid")
    return config
