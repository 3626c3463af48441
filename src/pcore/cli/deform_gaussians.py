"""`pcore deform` of Gaussians: a 3DGS file in, the edited one out."""

from __future__ import annotations

from pathlib import Path

from pcore.cli.change import change_lines, fold_notes
from pcore.data.splat_formats import read_splats, save_splats
from pcore.editing.gaussian_edit import BENT, EditedGaussians, edited_gaussians
from pcore.editing.script import EditScript


def deform_gaussians(
    source: Path, script: EditScript, output: Path, *, strict: bool, split: float | None
) -> list[str]:
    """Read Gaussians, move them, write them.

    Args:
        source: file of Gaussians.
        script: the edit.
        output: where to.
        strict: refuse an edit that folds space anywhere.
        split: tolerance for splitting Gaussians that the edit bends; None splits none.

    Returns:
        What was done, line by line.
    """
    file = read_splats(source)
    edited = edited_gaussians(file, script, split=split, allow_folds=not strict)
    said = save_splats(output, edited.file)
    before, after = file.gaussians.means, edited.bound.setting.points
    kinds = ", ".join(edit.type for edit in script.edits) or "no edit"
    degree = file.gaussians.degree
    notes = [*file.notes, *edit_notes(edited), *edited.bound.notes, *said]
    return [
        f"{source}: {len(before):,} Gaussians, harmonics of degree {degree}, {kinds}",
        *change_lines(before, after),
        *(f"  note: {line}" for line in notes),
        f"written to {output}",
    ]


def edit_notes(edited: EditedGaussians) -> list[str]:
    """Say what is odd about an edit of Gaussians, a line each."""
    total = len(edited.bound.setting.points)
    notes = fold_notes(edited.folds, total)
    if edited.bent:
        notes.append(
            f"{edited.bent:,} of the {edited.looked_at:,} largest Gaussians are bent within "
            f"themselves by more than {BENT:g} of their thickness and stay straight; "
            f"--split {BENT:g} makes several of each"
        )
    if edited.split:
        now = len(edited.file.gaussians)
        notes.append(f"{edited.split:,} Gaussians that the edit bends were split; now {now:,}")
    if edited.mended:
        notes.append(f"at {edited.mended:,} Gaussians the shape of the map is a substitute")
    return notes
