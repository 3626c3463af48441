"""Linear blend skinning: points follow the rigid motions of a few anchors.

Paper, "Application: Skinning Weights Optimization": p' = sum_k w_k (R_k p + t_k).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.deform.base import Deformation, check_points
from pcore.errors import InputError
from pcore.geometry.rotation import nearest_rotation


@dataclass(frozen=True, kw_only=True)
class SkinningWeights:
    """Which anchors carry every point, and how much.

    Attributes:
        anchors: (N, K) int64 indices of anchors.
        values: (N, K) weights, not negative, sum 1 per point.
    """

    anchors: Tensor
    values: Tensor


@dataclass(frozen=True, kw_only=True)
class AnchorPose:
    """Rigid motions of M anchors, each about the anchor itself.

    Attributes:
        rest: (M, 3) where the anchors are before the edit, world units.
        moved: (M, 3) where they are after it.
        rotations: (M, 3, 3) how what they carry is turned.
    """

    rest: Tensor
    moved: Tensor
    rotations: Tensor

    def __post_init__(self) -> None:
        count = self.rest.shape[0]
        shapes = [tuple(t.shape) for t in (self.rest, self.moved, self.rotations)]
        if shapes != [(count, 3), (count, 3), (count, 3, 3)]:
            raise InputError(
                "anchor pose: expected rest (M, 3), moved (M, 3) and rotations (M, 3, 3), "
                f"got {shapes[0]}, {shapes[1]} and {shapes[2]}"
            )
        if not all(bool(torch.isfinite(t).all()) for t in (self.moved, self.rotations)):
            raise InputError("anchor pose: expected finite numbers, got NaN or infinity")

    @property
    def translations(self) -> Tensor:
        """(M, 3) t = moved - R rest, so that p -> R p + t is the motion (paper)."""
        return self.moved - (self.rotations @ self.rest.unsqueeze(-1)).squeeze(-1)


@dataclass(frozen=True, kw_only=True)
class Skinned:
    """Points after skinning.

    Attributes:
        positions: (N, 3) world units.
        linear: (N, 3, 3) sum_k w_k R_k: how the neighbourhood of each point is turned (and, where
            the anchors disagree, squeezed). The change of the weights along space is left out.
    """

    positions: Tensor
    linear: Tensor


def pose_of(deformation: Deformation, anchors: Tensor) -> AnchorPose:
    """Rigid motions of anchors (M, 3) under a known field: the rotation nearest to its Jacobian.

    The paper takes the Jacobian by finite differences; every `Deformation` here has it exactly.
    No gradient flows into the motions: the field is given.
    """
    with torch.no_grad():
        places = anchors.detach().double()
        return AnchorPose(
            rest=anchors.detach(),
            moved=deformation(places).to(anchors.dtype),
            rotations=nearest_rotation(deformation.jacobian(places)).to(anchors.dtype),
        )


def skin(points: Tensor, weights: SkinningWeights, pose: AnchorPose) -> Skinned:
    """Linear blend skinning, differentiable in points, weights and motions.

    It is computed as p + sum_k w_k ((R_k - 1) p + t_k): a point all of whose anchors stay at rest
    moves by exactly nothing.

    Args:
        points: (N, 3) world units.
        weights: of these points.
        pose: where the anchors are.

    Raises:
        InputError: weights of another number of points.
    """
    if weights.anchors.shape != weights.values.shape or len(weights.anchors) != len(points):
        raise InputError(
            f"skinning: expected weights of {len(points)} points, got anchors "
            f"{tuple(weights.anchors.shape)} and values {tuple(weights.values.shape)}"
        )
    eye = torch.eye(3, dtype=pose.rotations.dtype, device=pose.rotations.device)
    turn = pose.rotations - eye
    shift = (pose.moved - pose.rest) - (turn @ pose.rest.unsqueeze(-1)).squeeze(-1)
    table = torch.cat([turn.flatten(1), shift], dim=1).to(points)
    # One fused gather and weighted sum: the (N, K, 12) table of motions is never built.
    mixed = F.embedding_bag(
        weights.anchors.to(points.device),
        table,
        per_sample_weights=weights.values.to(points),
        mode="sum",
    )
    turned, moved = mixed[:, :9].unflatten(1, (3, 3)), mixed[:, 9:]
    x, y, z = points.unsqueeze(-1).unbind(dim=1)
    offset = turned[..., 0] * x + turned[..., 1] * y + turned[..., 2] * z + moved
    return Skinned(positions=points + offset, linear=turned + eye.to(points))


Weigher = Callable[[Tensor], SkinningWeights]
"""Skinning weights of any points (N, 3): by distance, or learned."""


def softmax_weights(candidates: Tensor, logits: Tensor) -> SkinningWeights:
    """Weights from the logits (N, K) of candidate anchors (N, K); minus infinity gives 0."""
    return SkinningWeights(anchors=candidates, values=torch.softmax(logits, dim=-1))


def gaussian_logits(distances: Tensor, sigma: float) -> Tensor:
    """Logits -d^2 / (2 sigma^2); their softmax is exp(-d^2 / 2 sigma^2), normalised to sum 1.

    Args:
        distances: of points to anchors, world units.
        sigma: world units (paper, after Huang et al. 2023: 1).
    """
    if not sigma > 0:
        raise InputError(f"Gaussian weights: expected a sigma above 0, got {sigma}")
    return -0.5 * (distances / sigma).square()


@dataclass(frozen=True, kw_only=True, eq=False)
class SkinnedDeformation(Deformation):
    """Skinning by a fixed pose as a map of space.

    Attributes:
        pose: where the anchors are.
        weigher: weights of any points.
        bound: (N, 3) points whose weights are known already, normally the cloud.
        weights: of the bound points.
    """

    pose: AnchorPose
    weigher: Weigher = field(repr=False)
    bound: Tensor = field(repr=False)
    weights: SkinningWeights = field(repr=False)
    _last: list[tuple[Tensor, int, Skinned]] = field(
        init=False, repr=False, default_factory=list[tuple[Tensor, int, "Skinned"]]
    )

    def __call__(self, points: Tensor) -> Tensor:
        """Map points (..., 3)."""
        return self.at(points).positions.reshape(points.shape)

    def at(self, points: Tensor) -> Skinned:
        """Positions and linear parts of points (..., 3), flattened to (N, 3) and (N, 3, 3)."""
        check_points(points)
        # Whoever moves points asks for their Jacobians next: both are one blend.
        for known, version, found in self._last:
            if known is points and version == points._version:
                return found
        flat = points.reshape(-1, 3)
        found = skin(flat, self._weights(flat), self.pose)
        # Kept only where it is certain that autograd follows nothing.
        if torch.is_grad_enabled() and not found.positions.requires_grad:
            self._last[:] = [(points, points._version, found)]
        return found

    def jacobian(self, points: Tensor) -> Tensor:
        """Return the blended linear parts (..., 3, 3): the derivative with the weights held.

        The weights change from point to point too, but only their blend is smooth: candidates come
        and go, and where anchors disagree the change of the weights says nothing of the surface.
        """
        return self.at(points).linear.reshape(*points.shape, 3)

    def _weights(self, points: Tensor) -> SkinningWeights:
        # Neighbours are searched on the CPU, wherever the points are.
        places = points.detach().cpu()
        known = places.shape == self.bound.shape and torch.equal(places.float(), self.bound.float())
        return self.weights if known else self.weigher(places)
