"""What an edit did to points, in lines."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pcore.deform.checks import Folds
from pcore.geometry.point_cloud import size_of

_COARSE = 1e-4
"""Steps between the numbers of a file, as a share of the object, that are told of."""


def change_lines(before: Tensor, after: Tensor) -> list[str]:
    """Extents of points (N, 3) before and after, and how far they went."""
    digits = _digits(before)
    lines: list[str] = []
    for name, points in (("before", before), ("after", after)):
        lower, upper = points.amin(dim=0).tolist(), points.amax(dim=0).tolist()
        box = "  ".join(
            f"{axis} {lo:.{digits}g} to {hi:.{digits}g}"
            for axis, lo, hi in zip("xyz", lower, upper, strict=True)
        )
        lines.append(f"  {name}: {box}")
    distance = (after - before).norm(dim=-1)
    mean, most = float(distance.mean()), float(distance.max())
    lines.append(f"  moved by {mean:.4g} on average, {most:.4g} at most")
    return lines


def fold_notes(folds: Folds, total: int) -> list[str]:
    """Say that an edit folds or shears space at some of the points; nothing where it does not."""
    notes: list[str] = []
    if folds.sheared:
        notes.append(
            f"the edit shears space more than a run can render at {folds.sheared:,} of {total:,} "
            'points; is its "origin" far from them?'
        )
    if folds.folded:
        notes.append(
            f"the edit flattens space or turns it inside out at {folds.folded:,} of {total:,} "
            "points; a run would refuse to render it"
        )
    return notes


def coarse(given: Tensor) -> list[str]:
    """Say so where the precision of a file, the type of its points (N, 3), is coarse for them."""
    size, farthest = size_of(given.double()), float(given.abs().max())
    step = farthest * torch.finfo(given.dtype).eps
    if not step > _COARSE * size > 0:
        return []
    return [
        f"numbers of the file's precision are {step:.2g} apart at these coordinates, and the "
        f"object is {size:.3g} large; write it in double precision or near the origin"
    ]


def _digits(points: Tensor) -> int:
    """Significant digits with which coordinates show four of the object itself."""
    size, farthest = size_of(points), float(points.abs().max())
    return 4 + (max(0, math.ceil(math.log10(farthest / size))) if size > 0 and farthest > 0 else 0)
