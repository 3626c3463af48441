"""Motions of parts of an object as numbers that are learned: limbs are rigid, joints bend."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import chain

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pcore.deform.skinning import AnchorPose
from pcore.fitting.anchor_motion import AnchorSpace, rotation_matrices, rotation_vectors
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


_REACH = 0.5
"""Places about an anchor that its turn carries along, in spacings."""
_APART = 1.0
"""How far, in spacings, places of an anchor may miss a motion that two parts share."""

Doubles = NDArray[np.float64]


def rigid_parts(pose: AnchorPose, links: Tensor, spacing: float) -> Tensor:
    """Number (M,) the parts of anchors that nearly share a rigid motion.

    Linked parts are merged in the order of what a common motion misses more than two (Ward 1963),
    until it misses too much. There are as many parts as it takes; each is in one piece.

    Args:
        pose: M anchors.
        links: (E, 2) linked pairs.
        spacing: mean distance of neighbours, world units.
    """
    first, second = around(pose, spacing)
    merging = _Merging(sums=_sums(first.numpy(), second.numpy()))
    merging.link(links.tolist())
    most = first.shape[1] * (_APART * spacing) ** 2
    while merging.costs:
        pair, (cost, misfit) = min(merging.costs.items(), key=lambda item: item[1][0])
        if cost > most:
            break
        merging.merge(*pair, misfit)
    return torch.from_numpy(np.unique(merging.parts(), return_inverse=True)[1])


def around(pose: AnchorPose, spacing: float) -> tuple[Tensor, Tensor]:
    """Six places about every anchor, (M, 6, 3) float64, at rest and carried along, world units."""
    eye = _REACH * spacing * torch.eye(3, dtype=torch.float64)
    offsets = torch.cat([eye, -eye])
    rest, moved, turns = (
        part.detach().cpu().double() for part in (pose.rest, pose.moved, pose.rotations)
    )
    return rest.unsqueeze(1) + offsets, moved.unsqueeze(1) + offsets @ turns.mT


def _sums(first: Doubles, second: Doubles) -> Doubles:
    """What adds up when parts are merged, (M, 17): number, places, products, squares."""
    count = np.full((len(first), 1), first.shape[1], dtype=np.float64)
    products = np.einsum("mki,mkj->mij", second, first).reshape(-1, 9)
    squares = (np.square(first) + np.square(second)).sum(axis=(1, 2))[:, None]
    return np.concatenate([count, first.sum(1), second.sum(1), products, squares], axis=1)


def _misfits(sums: Doubles) -> Doubles:
    """Squared distances (P,) that the best rigid motion of each leaves (Kabsch 1976)."""
    count, before, after = sums[:, :1], sums[:, 1:4], sums[:, 4:7]
    products = sums[:, 7:16].reshape(-1, 3, 3)
    products = products - after[:, :, None] * before[:, None] / count[:, None]
    squares = sums[:, 16] - (np.square(before) + np.square(after)).sum(1) / count[:, 0]
    left, sizes, right = np.linalg.svd(products)
    sizes[:, 2] *= np.sign(np.linalg.det(left @ right))
    return np.maximum(squares - 2 * sizes.sum(1), 0)


@dataclass(kw_only=True)
class _Merging:
    """Parts so far, named by one of their anchors, and what it costs to merge linked ones."""

    sums: Doubles
    misfits: Doubles = field(init=False)
    owners: NDArray[np.int64] = field(init=False)
    linked: dict[int, set[int]] = field(init=False)
    costs: dict[tuple[int, int], tuple[float, float]] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self.misfits = np.zeros(len(self.sums))
        self.owners = np.arange(len(self.sums))
        self.linked = {one: set() for one in range(len(self.sums))}

    def parts(self) -> NDArray[np.int64]:
        """The part of every anchor."""
        return self.owners

    def link(self, pairs: list[list[int]]) -> None:
        for one, other in pairs:
            self.linked[one].add(other)
            self.linked[other].add(one)
        self._weigh({(min(pair), max(pair)) for pair in pairs})

    def merge(self, kept: int, gone: int, misfit: float) -> None:
        self.sums[kept] += self.sums[gone]
        self.misfits[kept] = misfit
        self.owners[self.owners == gone] = kept
        others = (self.linked[kept] | self.linked.pop(gone)) - {kept, gone}
        self.linked[kept] = others
        for other in others:
            self.linked[other] = self.linked[other] - {gone} | {kept}
        self.costs = {
            pair: cost for pair, cost in self.costs.items() if not {kept, gone}.intersection(pair)
        }
        self._weigh({(min(kept, other), max(kept, other)) for other in others})

    def _weigh(self, pairs: set[tuple[int, int]]) -> None:
        if not pairs:
            return
        rows = np.fromiter(chain.from_iterable(pairs), dtype=np.int64).reshape(-1, 2)
        misfits = _misfits(self.sums[rows].sum(axis=1))
        alone = self.misfits[rows].sum(axis=1)
        for pair, misfit, before in zip(pairs, misfits, alone, strict=True):
            self.costs[pair] = float(misfit - before), float(misfit)
