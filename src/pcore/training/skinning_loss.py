"""What fine-tuning moves by skinning: points and surface points; rays stay with the field.

Paper, "Application: Skinning Weights Optimization": the skinning "replaces the direct analytical
deformation for the point cloud and surface points", and "camera rays are still deformed
analytically". Pure functions; gradients reach the skinning network through the weights.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from pcore.deform.base import Deformation
from pcore.deform.skinning import AnchorPose, Skinned, skin
from pcore.model.skinning import Prior, Skinning


@dataclass(frozen=True, kw_only=True)
class SkinnedScene:
    """A cloud and the surface points of a patch after skinning by one pose.

    Attributes:
        points: of the cloud, (N, 3) and (N, 3, 3).
        surface: (..., 3) the target that L_geo compares the deformed rendering with.
    """

    points: Skinned
    surface: Tensor


def skin_scene(
    skinning: Skinning, pose: AnchorPose, points: Tensor, prior: Prior, surface: Tensor
) -> SkinnedScene:
    """Move a cloud and canonical surface points by skinning.

    Args:
        skinning: the network and its anchors.
        pose: rigid motions of the anchors under the field, from `pose_of`.
        points: (N, 3) canonical points, world units.
        prior: of these points; they stay, so it is found once.
        surface: (..., 3) canonical surface points, already without gradient (sg of the paper).
    """
    flat = surface.reshape(-1, 3)
    beside = skinning.weights(flat, skinning.prior(flat))
    return SkinnedScene(
        points=skin(points, skinning.weights(points, prior), pose),
        surface=skin(flat, beside, pose).positions.reshape(surface.shape),
    )


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
