"""`pcore deform`: apply an edit file to bare points, or to the Gaussians of a 3DGS file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from pcore.asset.posing import script_of
from pcore.cli.change import change_lines, coarse, fold_notes
from pcore.cli.deform_gaussians import deform_gaussians
from pcore.cli.options import Number, optional
from pcore.data.points import POINT_SUFFIXES, check_point_path, read_point_file, save_moved
from pcore.data.splat_formats import check_splat_output, holds_splats
from pcore.deform.checks import count_folds
from pcore.errors import InputError


@dataclass(frozen=True, kw_only=True)
class DeformCommand:
    """Apply an edit file to a set of points, or to Gaussians, and write what was moved."""

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="POINTS")]
    """Points to move: a NumPy array (N, 3) in a .npy file, or the vertices of a .ply. Or Gaussians:
    the .ply of a 3DGS or 2DGS trainer, .splat, .spz, .sog."""

    edit: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """Edit file (JSON); an edit without "extent" takes that of these points, as Blender does."""

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT")]
    """Where to write: .npy or .ply; a PLY of a PLY keeps all that the file holds, and its normals
    are turned. For Gaussians: .ply, .splat or .glb. Replaced if it exists."""

    time: Number = None
    """For an edit file with keyframes: the time to apply."""

    split: Annotated[float | None, optional("TOLERANCE")] = None
    """Gaussians only: split those that the edit bends within themselves by more than this share of
    their thickness, such as 0.3; default: split none."""

    strict: bool = False
    """Refuse an edit that folds space anywhere, as rendering does, instead of only saying so."""

    def run(self) -> None:
        """Do it; see `deform`."""
        deform(self)


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
