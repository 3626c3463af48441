"""`pcore deform`: points in and the edited ones out; or the Gaussians of a 3DGS file."""

from __future__ import annotations

from pathlib import Path

from pcore.asset.posing import script_of
from pcore.cli.change import change_lines, coarse, fold_notes
from pcore.cli.deform import DeformCommand
from pcore.data.points import POINT_SUFFIXES, check_point_path, read_point_file, save_moved
from pcore.data.splat_formats import check_splat_output, holds_splats, read_splats, save_splats
from pcore.deform.checks import count_folds
from pcore.editing.gaussian_edit import BENT, EditedGaussians, edited_gaussians
from pcore.editing.script import EditScript
from pcore.errors import InputError


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


def deform(command: DeformCommand) -> None:
    """Read points and edits, move the points in double precision, write them and say what was done.

    The result has the precision of the input file.
    """
    gaussians, kind = holds_splats(command.input), command.input.suffix.lower()
    if not gaussians and kind not in POINT_SUFFIXES:
        raise InputError(
            f"{command.input}: expected points (.npy, .ply) or Gaussians (.ply, .splat, .spz, "
            f".sog), got {kind or 'no ending'!r}"
        )
    check = check_splat_output if gaussians else check_point_path
    check(command.output)
    if _same_file(command.input, command.output):
        raise InputError(
            f"{command.output}: expected an output other than the input, got the same file; "
            "the points would be lost"
        )
    script = script_of(command.edit, command.time)
    if gaussians:
        strict, split = command.strict, command.split
        lines = deform_gaussians(command.input, script, command.output, strict=strict, split=split)
        print("\n".join(lines))
        return
    if command.split is not None:
        raise InputError(f"--split: expected a file of Gaussians, got points in {command.input}")
    source = read_point_file(command.input)
    points = source.positions.double()
    bound = script.bound(points, allow_folds=not command.strict)
    deformation, moved = bound.deformation, bound.setting.points
    maps = deformation.jacobian(points) if source.has_normals else None
    left = save_moved(command.output, source, moved.to(source.positions.dtype), maps)
    kinds = ", ".join(edit.type for edit in script.edits) or "no edit"
    print(f"{command.input}: {len(points):,} points, {kinds}")
    print("\n".join(change_lines(points, moved)))
    odd = [*fold_notes(count_folds(deformation, points), len(points)), *coarse(source.positions)]
    for line in [*odd, *bound.notes, *source.notes, *left]:
        print(f"  note: {line}")
    print(f"written to {command.output}")


def _same_file(first: Path, second: Path) -> bool:
    return first.exists() and second.exists() and first.samefile(second)
