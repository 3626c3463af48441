"""An edit file applied to Gaussians that no run has: scans of other trainers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pcore.data.gaussian_file import GaussianFile
from pcore.deform.base import Deformation, uprightness
from pcore.editing.binding import Bound
from pcore.editing.script import EditScript
from pcore.gaussians.carry import carried
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.refine import bending, refined

BENT = 0.3
"""Departure from an affine map, in standard deviations, from which on it is seen."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EditedGaussians:
    """Gaussians after an edit, and what is to be said about it.

    Attributes:
        file: the moved Gaussians.
        bound: the edit, bound to all Gaussians at rest.
        folded: (N,) bool, where the edit flattens space or turns it inside out at a mean.
        mended: (N,) bool, where the map around a mean is a substitute.
        bent: how many are bent inside themselves by more than `BENT`, and were not split.
        split: how many were split.
    """

    file: GaussianFile
    bound: Bound
    folded: Tensor
    mended: Tensor
    bent: int
    split: int


def edited_gaussians(
    file: GaussianFile,
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
    means = file.gaussians.means.double()
    bound = script.bound(means, allow_folds=allow_folds)
    deformation = bound.deformation
    count = len(file.gaussians)
    parts = 0
    if split is not None:
        pieces = refined(file.gaussians, deformation, split)
        file = replace(file.chosen(pieces.origins.numpy()), gaussians=pieces.gaussians)
        parts = int((pieces.origins.bincount(minlength=count) > 1).sum())
        bent = 0
    else:
        bent = int((bending(file.gaussians, deformation).amax(dim=1) > BENT).sum())
    moved, maps = _moved(file.gaussians, deformation)
    return EditedGaussians(
        file=file.moved(moved, maps.numpy()),
        bound=bound,
        folded=~(uprightness(maps) > 0) | deformation.folded(file.gaussians.means),
        mended=deformation.mended(file.gaussians.means),
        bent=bent,
        split=parts,
    )


def _moved(gaussians: Gaussians, deformation: Deformation) -> tuple[Gaussians, Tensor]:
    means = gaussians.means.double()
    with torch.no_grad():
        maps = deformation.jacobian(means)
        return carried(gaussians, deformation(means), maps), maps
