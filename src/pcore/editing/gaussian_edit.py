"""An edit file applied to Gaussians that no run has: scans of other trainers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pcore.data.splat_file import SplatFile
from pcore.deform.base import SINGULAR, Deformation, uprightness
from pcore.deform.checks import Folds, count_folds
from pcore.editing.binding import Bound
from pcore.editing.script import EditScript
from pcore.gaussians.carry import carried
from pcore.gaussians.refine import bending, refined

BENT = 0.3
"""Departure from an affine map, in standard deviations, from which on it is seen."""


_LOOKED_AT = 2000
"""So many of the largest Gaussians are looked at for bends, which takes twelve times as long as
moving them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EditedGaussians:
    """Gaussians after an edit, and what is to be said about it.

    Attributes:
        file: the moved Gaussians.
        bound: the edit, bound to all Gaussians at rest.
        folds: at how many means the edit folds space, or shears it too much.
        mended: at how many means the shape of the map is a substitute.
        bent: how many of the `looked_at` largest are bent within themselves by more than `BENT`,
            and were not split.
        looked_at: see `bent`.
        split: how many were split.
    """

    file: SplatFile
    bound: Bound
    folds: Folds
    mended: int
    bent: int = 0
    looked_at: int = 0
    split: int = 0


def edited_gaussians(
    file: SplatFile,
    script: EditScript,
    *,
    split: float | None = None,
    allow_folds: bool = True,
) -> EditedGaussians:
    """Move Gaussians by an edit: means, covariances and colours, in double precision.

    Regions, cages, anchors and extents belong to the means, as they do to points.

    Args:
        file: what was read.
        script: the edit.
        split: tolerance of `refined`; None splits nothing.
        allow_folds: accept maps that fold space at some (not all) of the means.

    Raises:
        EditError: the edit does not fit the means, or folds space.
        InputError: a tolerance that is not greater than 0.
    """
    means, count = file.gaussians.means, len(file.gaussians)
    bound = script.bound(means, check=False)
    deformation, positions = bound.deformation, bound.setting.points
    with torch.no_grad():
        maps = deformation.jacobian(means)
    folds = _folds(deformation, means, maps)
    odd = sum(folds)
    if odd == count or (odd and not allow_folds):
        # This one raises, and says which edit and what to do.
        bound = script.bound(means, allow_folds=allow_folds)
    result = EditedGaussians(
        file=file, bound=bound, folds=folds, mended=int(deformation.mended(means).sum())
    )
    if split is None:
        largest = file.gaussians.scales.amax(dim=1).topk(min(_LOOKED_AT, count)).indices
        seen = file.gaussians.each(lambda tensor: tensor[largest])
        bent = int((bending(seen, deformation).amax(dim=1) > BENT).sum())
        result = replace(result, bent=bent, looked_at=len(seen))
    else:
        pieces = refined(file.gaussians, deformation, split)
        file = replace(file.chosen(pieces.origins.numpy()), gaussians=pieces.gaussians)
        parts = int((pieces.origins.bincount(minlength=count) > 1).sum())
        result = replace(result, split=parts)
        if parts:
            positions = deformation(file.gaussians.means)
            maps = deformation.jacobian(file.gaussians.means)
    moved = carried(file.gaussians, positions, maps)
    return replace(result, file=file.moved(moved, maps.numpy()))


def _folds(deformation: Deformation, means: Tensor, maps: Tensor) -> Folds:
    """Count the means (N, 3) where a map with these Jacobians (N, 3, 3) folds or shears space."""
    plain = type(deformation).folded is Deformation.folded
    if plain and bool((uprightness(maps) > SINGULAR).all()):
        return Folds(folded=0, sheared=0)
    return count_folds(deformation, means)
