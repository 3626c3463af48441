"""The direct loss of skinning: points against where the analytic field takes them."""

from __future__ import annotations

from torch import Tensor

from pcore.deform.base import Deformation


def position_loss(moved: Tensor, points: Tensor, deformation: Deformation, unit: float) -> Tensor:
    """Direct term: mean squared distance of skinned points from where the field takes them.

    Args:
        moved: (..., 3) skinned points.
        points: (..., 3) the same points before.
        deformation: the field D; no gradient flows through it.
        unit: length in which the distance is measured, world units.
    """
    offset = moved - deformation(points.detach())
    return (offset / unit).square().sum(dim=-1).mean()
