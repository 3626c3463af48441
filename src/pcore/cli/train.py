"""`pcore train SCENE -o RUN`: learn the points and networks of PAPR, or Gaussians, from photos."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from rich.console import Console
from rich.text import Text
from tyro.conf import Positional, arg

from pcore.cli.losses import LossOptions, check_weights
from pcore.cli.options import Count, optional
from pcore.cli.runtime import DeviceName
from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.data.scene import Scene
    from pcore.training.config import PretrainConfig

_HAZE = 0.5
"""More faint pixels than that per solid one are no rims (clean masks: `faint_share`)."""


@dataclass(frozen=True, kw_only=True)
class TrainCommand:
    """Learn a scene from its training views; every tenth of them only validates.

    Test views are never looked at.
    """

    scene: Annotated[Positional[Path], arg(metavar="SCENE")]
    """Folder of the scene, in the NeRF-Synthetic or PAPR-in-Motion layout."""

    output: Annotated[Path, arg(aliases=["-o"], metavar="RUN")]
    """Folder to make; new or empty, unless --resume."""

    model: Literal["papr", "gaussians"] = "papr"
    """papr: points and networks, the paper's object; gaussians: 3D Gaussians, minutes."""

    preset: Literal["tiny", "fast", "paper", "paper-lego"] = "tiny"
    """tiny: 2 CPU cores, minutes; fast: one GPU, not measured yet; paper: the original, hours;
    paper-lego: the original as it was set for its scene lego."""

    factor: Annotated[int, arg(metavar="N")] = 1
    """Down-scale images by this whole number (area mean)."""

    steps: Count = None
    """Optimiser steps; default: those of the preset."""

    points: Count = None
    """Points at the start; default: those of the preset."""

    origin: Annotated[Literal["camera", "reference"] | None, optional("{camera,reference}")] = None
    """Where rays begin for the networks: camera (the original) or reference (close
    before the object, whatever camera renders); default: that of the preset."""

    seed: Annotated[int, arg(metavar="N")] = 0
    """Seed of every random draw."""

    init: Annotated[str | None, optional("hull|grid|views|FILE")] = None
    """Where points start: hull (of the masks), grid (the original's; papr), views (near and far
    before the cameras; gaussians), or a PLY or NPY file. Default: hull, or grid or views when the
    images have no alpha."""

    background: Annotated[
        Literal["white", "black", "random"] | None, optional("{white,black,random}")
    ] = None
    """Colour behind images with alpha; default: that of the preset (white)."""

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

            train_gaussians(self, Console())
        else:
            train(self, Console())


def train(command: TrainCommand, console: Console) -> None:
    """Train as the command says.

    Raises:
        SceneError: the scene cannot be read.
        InputError: options that do not fit the scene, or an output folder in use.
        WeightsError: the preset asks for LPIPS weights that are missing.
        TrainingError: training diverged or cannot write.
        KeyboardInterrupt: Ctrl-C, after saving.
    """
    from pcore.cli.light import try_light
    from pcore.cli.runtime import pick_device, prepare_torch
    from pcore.cli.sessions import Session, disk_space, run_session, show_result
    from pcore.data.load import load_scene
    from pcore.files.records import to_dict
    from pcore.training.pretrain import pretrain

    prepare_torch(command.threads)
    device = pick_device(command.device)
    scene = load_scene(command.scene, factor=command.factor)
    config = _config(command, scene, console)
    command.losses.check(config, scene.split("train"))
    check_weights(config.lpips_weight, config.lpips_trunk)
    announce(console, scene, f"{command.preset}, {config.steps:,} steps on {device}")
    limit = config.grow.limit if config.grow else config.points
    session = Session(
        path=command.output,
        stage="pretrain",
        scene=command.scene,
        config={
            "preset": command.preset,
            "factor": command.factor,
            "pretrain": to_dict(config),
        },
        resume=command.resume,
        tensorboard=not command.no_tensorboard,
        needed=disk_space(config.model, max(limit, config.points)),
    )
    trained = run_session(
        session,
        lambda run, tell: pretrain(
            scene,
            config,
            folder=run,
            listener=tell,
            device=device,
            compiled=not command.no_compile,
        ),
        console,
    )
    if trained:
        try_light(command.output, scene, device, console)
    show_result(console, command.output, next_command=f"pcore finetune {command.output}")


def _config(command: TrainCommand, scene: Scene, console: Console) -> PretrainConfig:
    """Return the preset with what the command changes."""
    from pcore.training.presets import preset

    changes: dict[str, Any] = {"seed": command.seed, **command.losses.changes()}
    for name in ("steps", "points", "background", "origin"):
        if getattr(command, name) is not None:
            changes[name] = getattr(command, name)
    if command.init in ("hull", "grid"):
        changes["start"] = command.init
    elif command.init is not None:
        if command.points is not None:
            raise InputError(
                f"--points {command.points}: expected no number where the points come from a file, "
                f"got --init {command.init} as well; leave one of the options out"
            )
        changes["start"] = str(Path(command.init).resolve())
    elif not all(view.has_alpha for view in scene.split("train")):
        console.print("images without alpha have no visual hull: points start on a grid")
        changes["start"] = "grid"
    config = replace(preset(command.preset), **changes)
    if config.start == "hull":
        _check_masks(scene, console)
    return config


def _check_masks(scene: Scene, console: Console) -> None:
    """Warn where masks would start points beside the object."""
    from pcore.cli.diagnosing import note
    from pcore.training.population import faint_share

    share = faint_share(scene.split("train"))
    if share > _HAZE:
        note(
            console,
            [
                f"the masks are hazy: for 100 pixels that show the object, {100 * share:.0f} are "
                "5 to 50 % opaque, and points will start in all of that; clean the alpha channels, "
                "or start without them: --init grid"
            ],
        )


def announce(console: Console, scene: Scene, plan: str) -> None:
    """Say in one line what is about to be trained."""
    views = scene.split("train")
    camera = views[0].camera
    console.print(
        Text(
            f"{scene.name}: {len(views)} training views of {camera.width} x {camera.height} "
            f"pixels; {plan}"
        ),
        soft_wrap=True,
    )
