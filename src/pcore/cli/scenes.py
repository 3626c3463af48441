"""Open a scene as verbs are told to: masks, and where its object is."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Literal

import torch
from rich.console import Console
from torch import Tensor

from pcore.capture.auto_masks import FoundMasks
from pcore.capture.corrected_copy import check_outside
from pcore.capture.load import load_scene
from pcore.capture.mask_folder import write_masks
from pcore.capture.scene_masks import scene_masks
from pcore.capture.triangulation import triangulated
from pcore.cli.console import counting, say
from pcore.cli.train import TrainCommand
from pcore.data.scene import Scene, View
from pcore.errors import InputError
from pcore.training.locate import Located, locate
from pcore.training.trained_masks import trained_masks


def opened(command: TrainCommand, console: Console) -> Scene:
    """Open the scene to train on, with its masks, and find the region of its object.

    Masks that are made for it are written into the run's folder; those that lie there are taken.
    """
    corners, made, tell = corners_of(command.box), command.output / "masks", partial(say, console)

    def loaded(source: Path | Literal["none"] | None) -> Located:
        scene = load_scene(command.scene, factor=command.factor, masks=source, tell=tell)
        check_outside(scene, command.output)
        if command.init == "sparse" and scene.sparse is None:
            scene = triangulated(scene, tell).scene
        return locate(scene, corners)

    masks = command.masks
    if masks not in ("auto", "trained"):
        return loaded("none" if masks == "none" else None if masks is None else Path(masks)).scene
    if not made.is_dir():
        bare = loaded("none")
        views, found = _cut_masks(bare, console) if masks == "auto" else _learned(bare, console)
        _write_masks(views, found, made, console)
    return loaded(made).scene


def corners_of(box: Sequence[float]) -> Tensor | None:
    """Lower and upper corner (2, 3) of six numbers; None of none."""
    if len(box) not in (0, 6):
        raise InputError(
            "--box: expected six numbers, X Y Z of the lower corner and X Y Z of the upper one, "
            f"got {len(box)}"
        )
    return torch.tensor(box).reshape(2, 3) if box else None


def _cut_masks(bare: Located, console: Console) -> tuple[Sequence[View], FoundMasks]:
    try:
        with counting(console, "masks") as tell:
            return scene_masks(bare.scene, bare.region, points=bare.points, progress=tell)
    except InputError as problem:
        say(console, f"{problem}. So the room is learned first")
        return _learned(bare, console)


def _learned(bare: Located, console: Console) -> tuple[Sequence[View], FoundMasks]:
    with counting(console, "learning the room for masks, steps") as tell:
        return trained_masks(bare.scene, progress=tell)


def _write_masks(views: Sequence[View], found: FoundMasks, folder: Path, console: Console) -> None:
    partial = folder.with_name(f"{folder.name}.partial")
    write_masks(views, found.masks, partial)
    partial.rename(folder)  # Whole or not at all.
    odd = [views[i].name for i in found.doubtful()]
    doubt = f"; look at {', '.join(odd[:8])}{', ...' * (len(odd) > 8)}" if odd else ""
    say(console, f"automatic masks of {len(views)} photos are in {folder}{doubt}")
