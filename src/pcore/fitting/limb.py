"""Ends of an object, the places at which they may bend, and their motions when they do."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.editing.anchors import AnchorGraph
from pcore.fitting.anchor_motion import rotation_matrices
from pcore.geometry.rotation import nearest_rotation, rotations

_REACHES = (0.2, 0.35, 0.5, 0.65, 0.8, 0.95, 1.1, 1.3)
"""Where a limb may bend: path lengths from its end, in those from the end to the middle."""
_STILL = (0.1, 0.4)
"""Shares of first guesses in which the outer and the inner place do not bend."""
_SLIGHT = 0.25, 0.5
"""Share of first guesses that are small turns, and their size, radians."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Limb:
    """An end of the object, and what of it moves if it bends at one of K places.

    Attributes:
        inside: (K, M) bool, which anchors move; each place has more of them than the one before.
        joints: (K, 3) the places at rest, world units.
        holders: (K, M) weights, sum 1, of the anchors that hold the moving part.
    """

    inside: Tensor
    joints: Tensor
    holders: Tensor


@dataclass(frozen=True, kw_only=True, eq=False)
class Bends:
    """B ways to bend a limb at two places.

    Attributes:
        places: (B, 2) numbers of places, the farther from the end first; the same one twice bends
            once.
        turns: (B, 2, 3, 3) rotations about them, world axes.
        straight: (B,) bool, whether the limb is first put as it is at rest.
    """

    places: Tensor
    turns: Tensor
    straight: Tensor

    def __getitem__(self, rows: Tensor) -> Bends:
        return Bends(places=self.places[rows], turns=self.turns[rows], straight=self.straight[rows])

    def varied(self, times: int, angle: float, draw: torch.Generator) -> Bends:
        """Return these and others near them, so many times as many; angle in radians."""
        many = self[torch.arange(len(self.places)).repeat(times)]
        change = turned_by(angle, (len(many.places), 2), draw)
        change[: len(self.places)] = torch.eye(3)
        return Bends(places=many.places, turns=change @ many.turns, straight=many.straight)


def turned_by(angle: float, shape: tuple[int, ...], draw: torch.Generator) -> Tensor:
    """Random rotations (*shape, 3, 3) by about an angle, radians."""
    vectors = angle * torch.randn(*shape, 3, generator=draw)
    return rotation_matrices(vectors.reshape(-1, 3)).reshape(*shape, 3, 3)


def limbs_of(graph: AnchorGraph, count: int) -> list[Limb]:
    """Limbs at anchors farthest from the middle and from one another, by paths on the object."""
    between = graph.between.double()
    middle = int(between.mean(dim=1).argmin())
    far = between[middle].clone()
    limbs: list[Limb] = []
    for _ in range(min(count, len(far))):
        end = int(far.argmax())
        limb = _limb(graph, end, float(between[middle, end]))
        limbs += [limb] if limb is not None else []
        far = torch.minimum(far, between[end])
    return limbs


def _limb(graph: AnchorGraph, end: int, length: float) -> Limb | None:
    rest = graph.rest.double()
    found: list[tuple[Tensor, Tensor, Tensor]] = []
    for reach in _REACHES:
        near = graph.between[end] <= reach * length
        across = near[graph.links[:, 0]] != near[graph.links[:, 1]]
        same = bool(found) and torch.equal(near, found[-1][0])
        if same or not bool(across.any()):
            continue
        pairs, weights = graph.links[across], graph.weights[across].double()
        weights = weights / weights.sum()
        outer = torch.where(near[pairs[:, 0]], pairs[:, 1], pairs[:, 0])
        holders = torch.zeros(len(rest), dtype=torch.float64).index_add(0, outer, weights)
        found.append((near, weights @ rest[pairs].mean(dim=1), holders))
    if not found:
        return None
    inside, joints, holders = (torch.stack(parts) for parts in zip(*found, strict=True))
    return Limb(inside=inside, joints=joints.float(), holders=holders.float())


def first_bends(limb: Limb, count: int, draw: torch.Generator) -> Bends:
    """Random bends: any turn at any place."""
    places = torch.randint(len(limb.joints), (count, 2), generator=draw)
    turns = rotations(torch.randn(count, 2, 4, generator=draw))
    slight = torch.rand(count, 1, generator=draw) < _SLIGHT[0]
    turns = torch.where(slight[..., None, None], turned_by(_SLIGHT[1], (count, 2), draw), turns)
    still = torch.rand(count, 2, generator=draw) < torch.tensor(_STILL)
    return Bends(
        places=places.sort(dim=1, descending=True).values,
        turns=torch.where(still[..., None, None], torch.eye(3), turns),
        straight=torch.rand(count, generator=draw) < 0.5,
    )


def about(turns: Tensor, places: Tensor) -> Tensor:
    """Motions (..., 3, 4) of space that turn (..., 3, 3) about places (..., 3)."""
    shift = places - (turns @ places.unsqueeze(-1)).squeeze(-1)
    return torch.cat([turns, shift.unsqueeze(-1)], dim=-1)


def after(second: Tensor, first: Tensor) -> Tensor:
    """Motions (..., 3, 4): the second after the first."""
    moved = second[..., :3] @ first
    return torch.cat([moved[..., :3], moved[..., 3:] + second[..., 3:]], dim=-1)


def places_after(motions: Tensor, places: Tensor) -> Tensor:
    """Where motions (..., 3, 4) take places (..., 3)."""
    return (motions[..., :3] @ places.unsqueeze(-1)).squeeze(-1) + motions[..., 3]


def bent(limb: Limb, bends: Bends, motions: Tensor) -> Tensor:
    """Motions (B, M, 3, 4) of the anchors after bends, from motions (M, 3, 4) before them."""
    held = torch.einsum("km,mij->kij", limb.holders, motions)
    joints = places_after(held, limb.joints)
    turns = nearest_rotation(held[..., :3])
    shift = joints - (turns @ limb.joints.unsqueeze(-1)).squeeze(-1)
    rigid = torch.cat([turns, shift.unsqueeze(-1)], dim=-1)
    outer, inner = bends.places.unbind(dim=1)
    start = torch.where(bends.straight[:, None, None, None], rigid[outer].unsqueeze(1), motions)
    swung = after(about(bends.turns[:, 0], joints[outer]).unsqueeze(1), start)
    held = torch.einsum("bm,bmij->bij", limb.holders[inner], swung)
    joint = places_after(held, limb.joints[inner])
    both = after(about(bends.turns[:, 1], joint).unsqueeze(1), swung)
    found = torch.where(limb.inside[outer][..., None, None], swung, motions)
    twice = limb.inside[inner] & (inner != outer).unsqueeze(1)
    return torch.where(twice[..., None, None], both, found)
