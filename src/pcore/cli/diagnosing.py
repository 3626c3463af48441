"""What the editing verbs say about an edit that may be going wrong."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from rich.console import Console

from pcore.cli.console import say

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

    from pcore.editing.diagnosis import Diagnosis
    from pcore.editing.handles import HandleDiagnosis


def note(console: Console, notes: Iterable[str]) -> None:
    """Print what is odd about edits and was not refused, each sentence once."""
    for line in dict.fromkeys(notes):
        say(console, f"warning: {line}", style="yellow")


def note_edit(console: Console, notes: Iterable[str], run: Path, edit: Path | None) -> None:
    """Print what is odd about an edit, and how to see where."""
    found = [*notes]
    note(console, found)
    if found and edit is not None:
        apply = f"pcore edit apply {run} --edit {edit} -o moved.ply --picture health.png"
        say(console, f"a picture of what goes wrong: {apply}")


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
