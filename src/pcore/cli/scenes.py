"""Open a scene as verbs are told to: masks, and where its object is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rich.console import Console
from rich.text import Text

from pcore.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

    from pcore.capture.auto_masks import FoundMasks
    from pcore.data.scene import View
    from pcore.training.locate import Located


def located_scene(
    path: Path,
    *,
    factor: int,
    masks: str | None,
    box: Sequence[float],
    made: Path,
    console: Console,
    points: bool = False,
) -> Located:
    """Load a scene, with masks, and find the region of its object.

    Args:
        path: the scene.
        factor: whole number by which images are down-scaled.
        masks: "auto" (cut, or by a short training where that fails), "trained", "none", a folder,
            or None: those that the scene brings.
        box: six numbers of a lower and an upper corner, or none.
        made: folder in the run that automatic masks are written to; those that lie there are taken.
        console: told of what is done.
        points: triangulate points where the scene has none (extra `colmap`).

    Raises:
        SceneError: the scene or a mask cannot be read.
        InputError: a bad box, masks that cannot be found, or a run inside the scene's folder.
        DependencyError: automatic masks without OpenCV.
        OSError: a mask cannot be written.
    """
    from pcore.capture.corrected_copy import check_outside
    from pcore.capture.load import load_scene
    from pcore.capture.triangulation import triangulated
    from pcore.training.locate import locate

    corners = corners_of(box)

    def loaded(source: Path | Literal["none"] | None) -> Located:
        scene = load_scene(path, factor=factor, masks=source, tell=console.print)
        check_outside(scene, made.parent)
        if points and scene.sparse is None:
            scene = triangulated(scene, console.print).scene
        return locate(scene, corners)

    if masks not in ("auto", "trained"):
        return loaded("none" if masks == "none" else None if masks is None else Path(masks))
    if not made.is_dir():
        bare = loaded("none")
        views, found = _cut_masks(bare, console) if masks == "auto" else _learned(bare, console)
        _write_masks(views, found, made, console)
    return loaded(made)


def corners_of(box: Sequence[float]) -> Tensor | None:
    """Lower and upper corner (2, 3) of six numbers; None of none."""
    import torch

    if len(box) not in (0, 6):
        raise InputError(
            "--box: expected six numbers, X Y Z of the lower corner and X Y Z of the upper one, "
            f"got {len(box)}"
        )
    return torch.tensor(box).reshape(2, 3) if box else None


def _cut_masks(bare: Located, console: Console) -> tuple[Sequence[View], FoundMasks]:
    from pcore.capture.scene_masks import scene_masks
    from pcore.cli.results import counting

    try:
        with counting(console, "masks") as tell:
            return scene_masks(bare.scene, bare.region, points=bare.points, progress=tell)
    except InputError as problem:
        console.print(Text(f"{problem}. So the room is learned first"), soft_wrap=True)
        return _learned(bare, console)


def _learned(bare: Located, console: Console) -> tuple[Sequence[View], FoundMasks]:
    from pcore.cli.results import counting
    from pcore.training.trained_masks import trained_masks

    with counting(console, "learning the room for masks, steps") as tell:
        return trained_masks(bare.scene, progress=tell)


def _write_masks(views: Sequence[View], found: FoundMasks, folder: Path, console: Console) -> None:
    from pcore.capture.mask_folder import write_masks

    partial = folder.with_name(f"{folder.name}.partial")
    write_masks(views, found.masks, partial)
    partial.rename(folder)  # Whole or not at all.
    odd = [views[i].name for i in found.doubtful()]
    doubt = f"; look at {', '.join(odd[:8])}{', ...' * (len(odd) > 8)}" if odd else ""
    console.print(
        Text(f"automatic masks of {len(views)} photos are in {folder}{doubt}"), soft_wrap=True
    )
