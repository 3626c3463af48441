"""Motions of anchors as numbers that are learned, and how far from rigid they are."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from pcore.deform.skinning import AnchorPose
from pcore.editing.anchors import AnchorGraph

_TURNS = 0.3
"""Weight of differing turns of linked anchors against stretched links."""


def rotation_matrices(vectors: Tensor) -> Tensor:
    """Rotations (M, 3, 3) by vectors (M, 3), axis times angle in radians (Rodrigues)."""
    square = vectors.square().sum(dim=-1)[:, None, None]
    # The root of nothing has no gradient; the series below does not need it.
    small = square < 1e-8
    angle = torch.where(small, torch.ones_like(square), square).sqrt()
    sine = torch.where(small, 1 - square / 6, angle.sin() / angle)
    versine = torch.where(small, 0.5 - square / 24, (1 - angle.cos()) / angle.square())
    zero = torch.zeros_like(vectors[:, 0])
    x, y, z = vectors.unbind(dim=-1)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    return torch.eye(3).to(vectors) + sine * cross + versine * (cross @ cross)


def rotation_vectors(matrices: Tensor) -> Tensor:
    """Vectors (M, 3), axis times angle in radians, of rotations (M, 3, 3)."""
    vectors = Rotation.from_matrix(matrices.detach().cpu().double().numpy()).as_rotvec()
    return torch.from_numpy(vectors).to(matrices)


@dataclass(frozen=True, kw_only=True, eq=False)
class AnchorSpace:
    """The numbers (M, 6) that say how M anchors move: ways in mean spacings, and turns.

    Attributes:
        rest: (M, 3) anchors at rest, float32, world units.
        links: (E, 2) linked pairs.
        weights: (E,) of the links.
        spacing: mean distance of neighbours, world units.
    """

    rest: Tensor
    links: Tensor
    weights: Tensor
    spacing: float

    @classmethod
    def of(cls, graph: AnchorGraph, device: torch.device) -> AnchorSpace:
        """Return that of a graph, on a device."""
        return cls(
            rest=graph.rest.float().to(device),
            links=graph.links.to(device),
            weights=graph.weights.float().to(device),
            spacing=graph.spacing,
        )

    def pose(self, numbers: Tensor) -> AnchorPose:
        """Return the pose that numbers (M, 6) mean; gradients reach them."""
        return AnchorPose(
            rest=self.rest,
            moved=self.rest + self.spacing * numbers[:, :3],
            rotations=rotation_matrices(numbers[:, 3:]),
        )

    def numbers(self, pose: AnchorPose) -> Tensor:
        """Return the numbers (M, 6) of a pose of these anchors."""
        ways = (pose.moved.to(self.rest) - self.rest) / self.spacing
        return torch.cat([ways, rotation_vectors(pose.rotations).to(ways)], dim=1)

    def smoother(self, spread: float) -> Tensor:
        """(M, M) matrix 1 + spread L, with the Laplacian L of the links."""
        count = len(self.rest)
        first, second = self.links.unbind(dim=1)
        laplacian = self.rest.new_zeros(count, count)
        laplacian[first, second] = -self.weights
        laplacian[second, first] = -self.weights
        laplacian -= torch.diag(laplacian.sum(dim=1))
        return torch.eye(count).to(laplacian) + spread * laplacian

    def bending(self, pose: AnchorPose) -> Tensor:
        """How far a pose is from rigid, without unit (Sorkine and Alexa 2007; Sumner 2007).

        Mean over links of the squared misfit of a turned link with the moved one, in spacings, at
        both its ends, and of the difference of the two turns.
        """
        first, second = self.links.unbind(dim=1)
        rest = (self.rest[second] - self.rest[first]).unsqueeze(-1)
        moved = pose.moved[second] - pose.moved[first]
        turns = pose.rotations[first], pose.rotations[second]
        misfit = sum(((turn @ rest).squeeze(-1) - moved).square().sum(dim=-1) for turn in turns)
        differ = (turns[0] - turns[1]).square().sum(dim=(-1, -2))
        each = misfit / self.spacing**2 + _TURNS * differ
        return (self.weights * each).sum() / self.weights.sum()
