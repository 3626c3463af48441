"""Gaussians as methods: one set of them, and a rule how they follow a state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.content import Sampling
from pcore.asset.gaussian_content import GaussianContent, MovedGaussians
from pcore.errors import EditError, InputError
from pcore.evaluation.asset_method import moved
from pcore.evaluation.health import Health, health_of
from pcore.evaluation.runner import Tells
from pcore.evaluation.states import State
from pcore.gaussians.carry import polar
from pcore.gaussians.render import PosedGaussians, pose
from pcore.geometry.camera import Camera
from pcore.render.image import Image
from pcore.rivals.nodes import carried_by_nodes, node_rig

Rule = Callable[[State], PosedGaussians]
"""Where a state takes the Gaussians, and what becomes of their shapes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GaussianMethod:
    """Gaussians that follow states by a rule.

    Attributes:
        name: for tables.
        content: the Gaussians at rest, on white.
        rule: how they follow.
        unseen: (N,) bool, which means no training view saw; None where that is not known.
    """

    name: str
    content: GaussianContent
    rule: Rule = field(repr=False)
    unseen: Tensor | None = None
    tells: Tells = "depth"

    def pose(self, state: State) -> MovedGaussians:
        """Move them.

        Raises:
            EditError: the rule cannot follow the state.
        """
        return MovedGaussians(drawn=self.rule(state))

    def draw(self, posed: MovedGaussians, camera: Camera) -> Image:
        """Take a picture."""
        return self.content.render(posed, camera, Sampling())

    def health(self, posed: MovedGaussians, state: State) -> Health:
        """Diagnose their means."""
        return health_of(self.content.points, self.content.points_of(posed), self.unseen)


def gaussian_content(asset: Asset) -> GaussianContent:
    """The Gaussians of an asset.

    Raises:
        InputError: it is made of something else.
    """
    if not isinstance(asset.content, GaussianContent):
        raise InputError(
            f"{asset.record.path or 'this object'}: expected an object of Gaussians, got "
            f"{type(asset.content).__name__}"
        )
    return asset.content


def turned_rule(asset: Asset) -> Rule:
    """Covariances Q S Q^T with Q the rotation of the local map; colours turned along."""
    gaussians = gaussian_content(asset).gaussians

    def rule(state: State) -> PosedGaussians:
        motion, error = moved(state, asset)
        if error is not None:
            raise EditError(f"state {state.name}: {error}") from error
        places = motion.positions.to(gaussians.means)
        if motion.local_maps is None:
            return PosedGaussians(gaussians=replace(gaussians, means=places))
        # The rotations of a map and of its inverse are each other's transposes.
        turns = polar(motion.local_maps.to_rest).mT.to(gaussians.means)
        return pose(gaussians, places, turns)

    return rule


def node_rule(asset: Asset, *, seed: int = 0) -> Rule:
    """SC-GS's: nodes go where the state takes them, Gaussians follow them rigidly."""
    gaussians = gaussian_content(asset).gaussians
    rig = node_rig(gaussians, seed=seed)
    return lambda state: carried_by_nodes(gaussians, rig, state.move(rig.nodes))
