"""`pcore deform`: apply an edit file to a bare set of points."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
import tyro

from pcore.data.points import check_point_path, read_point_file, save_moved
from pcore.deform.base import Deformation
from pcore.deform.checks import count_folds
from pcore.editing.script import load_edit
from pcore.errors import InputError
from pcore.geometry.extent import size_of

_COARSE = 1e-4
"""Steps between the numbers of a file, as a share of the object, that are told of."""


@dataclass(frozen=True, kw_only=True)
class DeformCommand:
    """Apply an edit file to a set of points and write the moved points."""

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="POINTS")]
    """Points to move: a NumPy array (N, 3) in a .npy file, or the vertices of a .ply."""

    edit: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """Edit file (JSON); an edit without "extent" takes that of these points, as Blender does."""

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT")]
    """Where to write: .npy or .ply; a PLY of a PLY keeps all that the file holds, and its normals
    are turned. Replaced if it exists."""

    strict: bool = False
    """Refuse an edit that folds space anywhere, as rendering does, instead of only saying so."""

    def run(self) -> None:
        """Do it; see `deform`."""
        deform(self)


def deform(command: DeformCommand) -> None:
    """Read points and edits, move the points in double precision, write them and say what was done.

    The result has the precision of the input file.

    Raises:
        InputError: the points cannot be read or written, or would replace their own file.
        EditError: the edit file is not valid or its deformation is singular at the points.
    """
    check_point_path(command.output)
    if _same_file(command.input, command.output):
        raise InputError(
            f"{command.output}: expected an output other than the input, got the same file; "
            "the points would be lost"
        )
    script = load_edit(command.edit)
    source = read_point_file(command.input)
    points = source.positions.double()
    bound = script.bound(points, allow_folds=not command.strict)
    deformation, moved = bound.deformation, bound.setting.points
    maps = deformation.jacobian(points) if source.has_normals else None
    left = save_moved(command.output, source, moved.to(source.positions.dtype), maps)
    kinds = ", ".join(edit.type for edit in script.edits) or "no edit"
    print(f"{command.input}: {len(points):,} points, {kinds}")
    _print_change(points, moved)
    _print_folds(deformation, points)
    _print_coarseness(source.positions)
    for line in [*bound.notes, *source.notes, *left]:
        print(f"  note: {line}")
    print(f"written to {command.output}")


def _print_change(points: torch.Tensor, moved: torch.Tensor) -> None:
    digits = _digits(points)
    for name, cloud in (("before", points), ("after", moved)):
        lower, upper = cloud.amin(dim=0).tolist(), cloud.amax(dim=0).tolist()
        box = "  ".join(
            f"{axis} {lo:.{digits}g} to {hi:.{digits}g}"
            for axis, lo, hi in zip("xyz", lower, upper, strict=True)
        )
        print(f"  {name}: {box}")
    distance = (moved - points).norm(dim=-1)
    print(
        f"  moved by {float(distance.mean()):.4g} on average, {float(distance.max()):.4g} at most"
    )


def _print_folds(deformation: Deformation, points: torch.Tensor) -> None:
    folded, sheared = count_folds(deformation, points)
    if sheared:
        print(
            f"  note: the edit shears space more than a run can render at {sheared:,} of "
            f'{len(points):,} points; is its "origin" far from them?'
        )
    if folded:
        print(
            f"  note: the edit flattens space or turns it inside out at {folded:,} of "
            f"{len(points):,} points; a run would refuse to render it"
        )


def _print_coarseness(given: torch.Tensor) -> None:
    """Say so where the precision of the file is coarse for the object."""
    size, farthest = size_of(given.double()), float(given.abs().max())
    step = farthest * torch.finfo(given.dtype).eps
    if step > _COARSE * size > 0:
        print(
            f"  note: numbers of the file's precision are {step:.2g} apart at these coordinates, "
            f"and the object is {size:.3g} large; write it in double precision or near the origin"
        )


def _digits(points: torch.Tensor) -> int:
    """Significant digits with which coordinates show four of the object itself."""
    size, farthest = size_of(points), float(points.abs().max())
    return 4 + (max(0, math.ceil(math.log10(farthest / size))) if size > 0 and farthest > 0 else 0)


def _same_file(first: Path, second: Path) -> bool:
    return first.exists() and second.exists() and first.samefile(second)
