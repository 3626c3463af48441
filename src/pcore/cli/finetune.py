"""`pcore finetune RUN`: teach a pre-trained run consistent surfaces (P-CORE)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.losses import LossOptions, check_weights
from pcore.cli.options import Count, Folder, PresetName, optional
from pcore.cli.runtime import DeviceName, pick_device, prepare_torch
from pcore.cli.torchrun import is_first
from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.asset.asset import Asset
    from pcore.asset.training import FinetuneSettings


@dataclass(frozen=True, kw_only=True)
class FinetuneCommand:
    """Fine-tune a run so that its surface follows any deformation; the run itself is not changed.

    Only training views of the undeformed scene are used. Runs of Gaussians are tuned as well;
    options of networks (skinning, rays, losses) are not for them.
    """

    run_folder: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of a pre-trained run, our own or imported."""

    output: Annotated[Path | None, optional("OUT", "-o")] = None
    """Folder to make; new or empty, unless --resume. Default: RUN-pcore beside RUN."""

    scene: Folder = None
    """Folder of the scene; default: the one the run was trained on."""

    factor: Count = None
    """Down-scaling of the images; default: that of the training."""

    preset: Annotated[PresetName | None, optional("{tiny,fast,paper}")] = None
    """Settings; default: those of the preset the run was trained with, paper for imported runs."""

    steps: Count = None
    """Optimiser steps; default: those of the preset."""

    seed: Annotated[int, arg(metavar="N")] = 0
    """Seed of every random draw."""

    skinning: bool = False
    """Learn skinning weights of 128 anchors along with the renderer, for edits by anchors."""

    skinning_recipe: Annotated[Literal["ours", "paper"] | None, optional("{ours,paper}")] = None
    """With --skinning: where the weights start and what teaches them; default: ours."""

    patches: Count = None
    """Patches of a step (gaussians: whole photos), whose loss is their mean; default: those of the
    preset. The processes that `torchrun` starts share them."""

    losses: Annotated[LossOptions, arg(name="")] = field(default_factory=LossOptions)
    """Weights of the losses; default: those of the preset."""

    rays: Literal["plain", "aware"] = "plain"
    """How the losses draw deformed states: plain as in the paper (better, ADR 5), or aware of the
    deformation."""

    resume: bool = False
    """Go on exactly where the run in the output folder was interrupted."""

    no_tensorboard: bool = False
    """Do not write OUT/tensorboard, the curves for TensorBoard (they need the extra `log`)."""

    device: DeviceName = "auto"
    """Where to train; auto takes a GPU where there is one."""

    no_compile: bool = False
    """Do not compile the networks on a GPU (torch.compile): slower, but needs no compiler."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Fine-tune; raises PcoreError subclasses for what the user can mend."""
        finetune_run(self, Console(quiet=not is_first()))


def finetune_run(command: FinetuneCommand, console: Console) -> None:
    """Fine-tune as the command says, together with the other processes that torchrun started.

    Only the first of them has the folder and says anything.
    """
    from pcore.asset.saving import load
    from pcore.asset.training import finetune
    from pcore.cli.sessions import show_result, trained_together
    from pcore.cli.train_checks import announce
    from pcore.files.run_place import check_place
    from pcore.training.config import FinetuneConfig

    prepare_torch(command.threads)
    device = pick_device(command.device)
    asset, output = load(command.run_folder), _output(command)
    if is_first():
        check_place(output, resume=command.resume)  # Before the photos are read.
    scene = asset.scene(command.scene, factor=command.factor)
    name, config = _config(command, asset)
    if isinstance(config, FinetuneConfig):
        command.losses.check(config, scene.split("train"))
        check_weights(config.lpips_weight, config.lpips_trunk)
    announce(console, scene, f"{name}, {config.steps:,} steps on {device}")
    tuned = trained_together(
        command,
        console,
        lambda folder, listener, options: finetune(
            asset, scene, config, folder=folder, listener=listener, device=device, options=options
        ),
        output=output,
        preset=name,
        device=device,
        scene=scene,
        given={"settings": config, "points of the run": asset.points},
    )
    if tuned is not None:
        show_result(console, tuned)


def _output(command: FinetuneCommand) -> Path:
    """Folder for the result; never the run itself."""
    run = command.run_folder.resolve()
    if command.output is None:
        # Typed paths stay as they are typed: they are shown to who typed them.
        parent = command.run_folder.parent if command.run_folder.name else run.parent
        return parent / f"{run.name}-pcore"
    if command.output.resolve() == run:
        raise InputError(
            f"{command.output}: expected a folder other than that of the run it starts from, "
            "which is left as it is; use another -o"
        )
    return command.output


def _config(command: FinetuneCommand, asset: Asset) -> tuple[PresetName, FinetuneSettings]:
    """Name of the preset and its settings with what the command changes."""
    from pcore.asset.training import finetune_settings
    from pcore.training.gaussian_config import GaussianFinetuneConfig
    from pcore.training.presets import skinning_preset

    name, config = finetune_settings(asset, command.preset)
    changes: dict[str, Any] = {"seed": command.seed}
    if command.steps is not None:
        changes["steps"] = command.steps
    if isinstance(config, GaussianFinetuneConfig):
        _refuse_networks(command)
        if command.patches is not None:
            changes["views"] = command.patches
        return name, replace(config, **changes)
    changes |= {"aware": command.rays == "aware", **command.losses.changes()}
    if command.patches is not None:
        changes["patch"] = replace(config.patch, views=command.patches)
    if command.skinning:
        changes["skinning"] = skinning_preset(command.skinning_recipe or "ours")
    elif command.skinning_recipe is not None:
        raise InputError(
            f"--skinning-recipe {command.skinning_recipe}: expected --skinning as well, without "
            "which no skinning is learned; give both, or leave the option out"
        )
    return name, replace(config, **changes)


def _refuse_networks(command: FinetuneCommand) -> None:
    """Raise InputError for options that only objects with networks have."""
    foreign: dict[str, Any] = {
        f"--{n.replace('_', '-')}": x for n, x in command.losses.changes().items()
    }
    foreign |= {
        "--skinning": command.skinning or None,
        "--skinning-recipe": command.skinning_recipe,
        "--rays aware": True if command.rays == "aware" else None,
        "--no-compile": command.no_compile or None,
    }
    given = [name for name, value in foreign.items() if value is not None]
    if given:
        raise InputError(
            f"{', '.join(given)}: expected options that Gaussians have, got some that only PAPR "
            "has; leave them out. Carried Gaussians are always aware of the deformation"
        )
