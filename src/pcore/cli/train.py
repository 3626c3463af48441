"""`pcore train SCENE -o RUN`: learn Gaussians, or the points and networks of PAPR, from photos."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.losses import LossOptions
from pcore.cli.options import Count, optional
from pcore.cli.runtime import DeviceName
from pcore.cli.torchrun import is_first


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
        from pcore.cli.training import train

        train(self, Console(quiet=not is_first()))
