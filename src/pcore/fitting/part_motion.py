"""Motions of parts of an object as numbers that are learned: limbs are rigid, joints bend."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.deform.skinning import AnchorPose
from pcore.fitting.anchor_motion import AnchorSpace, rotation_matrices, rotation_vectors
from pcore.fitting.rigid_parts import around, rigid_parts
from pcore.geometry.rotation import nearest_rotation

_LOOSE = 0.05
"""Weight of links between parts against those within."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PartSpace(AnchorSpace):
    """The numbers (K, 6) that say how K parts move, each about its middle; anchors follow.

    Attributes:
        parts: (M,) the part of every anchor.
    """

    parts: Tensor

    @classmethod
    def found(cls, space: AnchorSpace, pose: AnchorPose) -> PartSpace:
        """Return that of the parts which a pose of anchors shows."""
        parts = rigid_parts(pose, space.links.cpu(), space.spacing).to(space.rest.device)
        return cls(
            rest=space.rest,
            links=space.links,
            weights=space.weights,
            spacing=space.spacing,
            parts=parts,
        )

    def means(self, values: Tensor) -> Tensor:
        """(K, ...) means over the anchors of every part of values (M, ...)."""
        sums = values.new_zeros(int(self.parts.max()) + 1, *values.shape[1:])
        sums = sums.index_add(0, self.parts, values)
        count = self.parts.bincount().to(values).reshape(-1, *(1 for _ in values.shape[1:]))
        return sums / count

    def pose(self, numbers: Tensor) -> AnchorPose:
        """Return the pose of the anchors that numbers (K, 6) mean; gradients reach them."""
        middle = self.means(self.rest)
        turns = rotation_matrices(numbers[:, 3:])[self.parts]
        arms = (turns @ (self.rest - middle[self.parts]).unsqueeze(-1)).squeeze(-1)
        moved = (middle + self.spacing * numbers[:, :3])[self.parts] + arms
        return AnchorPose(rest=self.rest, moved=moved, rotations=turns)

    def numbers(self, pose: AnchorPose) -> Tensor:
        """Return the numbers (K, 6) of the rigid motions nearest to a pose of the anchors."""
        first, second = (part.to(self.parts.device) for part in around(pose, self.spacing))
        centers = [self.means(part.mean(dim=1)) for part in (first, second)]
        arms = [
            part - center[self.parts].unsqueeze(1)
            for part, center in zip((first, second), centers, strict=True)
        ]
        turns = nearest_rotation(self.means(arms[1].mT @ arms[0]))
        ways = (centers[1] - centers[0]) / self.spacing
        return torch.cat([ways, rotation_vectors(turns)], dim=1).to(self.rest)

    def smoother(self, spread: float) -> Tensor:
        """(K, K) identity: parts are not alike, so that no step is handed on."""
        return torch.eye(int(self.parts.max()) + 1).to(self.rest)

    def jointed(self) -> AnchorSpace:
        """The anchors by themselves, with links that give way between parts."""
        same = self.parts[self.links[:, 0]] == self.parts[self.links[:, 1]]
        return AnchorSpace(
            rest=self.rest,
            links=self.links,
            weights=torch.where(same, self.weights, _LOOSE * self.weights),
            spacing=self.spacing,
        )
