"""How a deformation moves the canonical scene: by its formula, or by a skinning that learns.

Paper, "Application: Skinning Weights Optimization": the skinning "replaces the direct analytical
deformation for the point cloud and surface points", and "camera rays are still deformed
analytically": rays are no matter of this module.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pcore.contrib.learned_skinning import Prior, Skinning, untrained_skinning
from pcore.contrib.skinning_loss import position_loss
from pcore.deform.anchor_distance import path_distance
from pcore.deform.base import Deformation
from pcore.deform.jacobian import maps_of, unchecked_maps
from pcore.deform.skinning import pose_of, skin
from pcore.geometry.farthest_points import farthest_points
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.training.config import SkinningTrainConfig
from pcore.training.consistency import Canonical


@dataclass(frozen=True, kw_only=True)
class MovedScene:
    """What a deformation makes of the canonical scene.

    Attributes:
        posed: the deformed points.
        surface: (*R, 3) where the canonical surface points of a patch go: the target of L_geo.
        terms: losses of the motion itself, weighted, by name.
    """

    posed: PosedCloud
    surface: Tensor
    terms: Mapping[str, Tensor]


Motion = Callable[[PointCloud, Canonical, Deformation], MovedScene]
"""Moves a cloud and the surface points of a patch by a field."""


@dataclass(frozen=True, kw_only=True)
class FieldMotion:
    """Everything goes where the field takes it.

    Attributes:
        aware: keep local maps, for deformation-aware rays.
    """

    aware: bool

    def __call__(
        self, cloud: PointCloud, canonical: Canonical, deformation: Deformation
    ) -> MovedScene:
        """See `Motion`."""
        positions = cloud.positions
        # The derivative of the maps is left out: it is small, and costs second derivatives.
        maps = unchecked_maps(deformation, positions.detach()) if self.aware else None
        return MovedScene(
            posed=PosedCloud(cloud=cloud, positions=deformation(positions), local_maps=maps),
            surface=deformation(canonical.surface),
            terms={},
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class SkinnedMotion:
    """Anchors go where the field takes them; points and surface points follow by learned weights.

    Attributes:
        skinning: the network and its anchors; gradients reach it through every place it decides.
        prior: of the cloud's points, which stay.
        config: target of L_geo, weight of the direct term.
        unit: length in which the direct term is measured, world units.
        aware: keep local maps, for deformation-aware rays.
    """

    skinning: Skinning
    prior: Prior
    config: SkinningTrainConfig
    unit: float
    aware: bool

    def __call__(
        self, cloud: PointCloud, canonical: Canonical, deformation: Deformation
    ) -> MovedScene:
        """See `Motion`."""
        points, skinning = cloud.positions, self.skinning
        # Positions need all their digits, whatever precision the renderer computes in.
        with torch.autocast(points.device.type, enabled=False):
            pose = pose_of(deformation, skinning.anchors)
            moved = skin(points, skinning.weights(points, self.prior), pose)
            surface = deformation(canonical.surface)
            if self.config.surface_target == "skinned":
                # Rays that miss the object have no surface point to carry.
                chosen = canonical.surface[canonical.foreground]
                beside = skinning.weights(chosen, skinning.prior(chosen))
                skinned = skin(chosen, beside, pose).positions
                surface = surface.index_put((canonical.foreground,), skinned)
            terms: dict[str, Tensor] = {}
            if self.config.position_weight > 0:
                error = position_loss(moved.positions, points, deformation, self.unit)
                terms["skinning"] = self.config.position_weight * error
        # As an edit by anchors is rendered: the maps are the blended rotations.
        maps = maps_of(points, moved.linear.detach()) if self.aware else None
        posed = PosedCloud(cloud=cloud, positions=moved.positions, local_maps=maps)
        return MovedScene(posed=posed, surface=surface, terms=terms)


def skinning_to_train(cloud: PointCloud, config: SkinningTrainConfig, *, seed: int) -> Skinning:
    """Choose the anchors of a cloud and build the network, on the device of the cloud.

    Args:
        cloud: canonical points; they must stay where they are.
        config: network and number of anchors.
        seed: of the network's hidden layers. That of the anchors is 0, as in an edit by anchors
            that does not ask for another.

    Raises:
        InputError: fewer points than anchors.
    """
    points = cloud.positions.detach().cpu()
    distance = path_distance(points, farthest_points(points, config.anchors))
    skinning = untrained_skinning(distance, config.network, seed=seed)
    return replace(skinning, network=skinning.network.to(cloud.positions.device).train())
