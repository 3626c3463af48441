"""What the editing verbs say about an edit that may be going wrong."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from pcore.errors import EditError

if TYPE_CHECKING:
    from torch import Tensor

    from pcore.editing.diagnosis import Diagnosis
    from pcore.editing.handles import HandleDiagnosis
    from pcore.editing.script import EditScript
    from pcore.geometry.camera import Camera


def training_cameras(source: Path, scene: Path | None) -> tuple[list[Camera], str]:
    """Cameras of the training views of a run, or none and why they are not known.

    Args:
        source: folder of a run, a model file or a file of points.
        scene: folder of the scene; None takes the one that the run was trained on.

    Raises:
        SceneError: the scene is damaged.
        CheckpointError: the run is damaged.
    """
    from pcore.cli.runtime import recorded_factor, recorded_scene
    from pcore.data.load import load_scene
    from pcore.files.run_folder import RunFolder

    run = RunFolder.open(source) if source.is_dir() else None
    folder = scene or recorded_scene(run)
    if folder is None:
        why = "the scene of the run is not here" if run else "points alone have no scene"
        return [], f"{why}; give it with --scene"
    found = load_scene(folder, factor=recorded_factor(run))
    return [view.camera for view in found.split("train")], ""


def script_at(path: Path, time: float | None) -> EditScript:
    """Read an edit file, at a time where it has keyframes.

    Raises:
        EditError: it is not valid, or has keyframes and no time is given.
    """
    from pcore.editing.animation import load_animation

    animation = load_animation(path)
    if time is None and animation.end > animation.start:
        raise EditError(
            f"{path}: expected --time between {animation.start:g} and {animation.end:g}, because "
            "it has keyframes, got none; or use `pcore animate`"
        )
    return animation.at(animation.start if time is None else time)


def note(console: Console, notes: Iterable[str]) -> None:
    """Print what is odd about edits and was not refused, each sentence once."""
    for line in dict.fromkeys(notes):
        console.print(Text(f"warning: {line}", "yellow"), soft_wrap=True)


def report(
    points: Tensor,
    moved: Tensor,
    found: Diagnosis,
    handles: dict[int, HandleDiagnosis],
    why_not: str,
) -> list[str]:
    """Say how far the points went and what may be going wrong.

    Args:
        points: (N, 3) before the edit.
        moved: (N, 3) after it.
        found: of these.
        handles: number of an edit by anchors -> its diagnosis.
        why_not: why it is not known what the training views saw; empty where it is.
    """
    way = (moved - points).norm(dim=-1)
    numbers = found.numbers()
    lines = [
        f"{len(points):,} points moved by {float(way.mean()):.4g} on average, "
        f"{float(way.max()):.4g} at most; {int((way == 0).sum()):,} did not move",
        f"strain: {numbers['strain_median']:.2f} in the middle, {numbers['strain_99']:.2f} at 99 "
        f"percent, {numbers['strain_max']:.2f} at most",
        f"hole score: {100 * numbers['hole_score']:.1f} % of the points come apart from a "
        f"neighbour; with plain rays {100 * numbers['hole_score_plain']:.1f} % stand too far apart",
        f"self-intersection: {100 * numbers['self_intersection']:.1f} % of the points met another "
        "part",
    ]
    if found.exposed is None:
        lines.append(f"exposed: not known, {why_not}")
    else:
        lines.append(
            f"exposed: {100 * numbers['exposed']:.1f} % of the points came to light that no "
            "training view saw"
        )
    return [*lines, *(_of_handles(number, one) for number, one in handles.items())]


def _of_handles(number: int, found: HandleDiagnosis) -> str:
    numbers = found.numbers()
    return (
        f"edit {number}, handles: anchors disagree at {100 * numbers['anchors_disagree']:.1f} % of "
        f"the points; {100 * numbers['without_handle']:.1f} % move with no handle near"
    )
