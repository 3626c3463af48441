"""Limbs that have moved far, found by trying: gradients see only what overlaps its new place."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.deform.skinning import AnchorPose
from pcore.editing.anchors import AnchorGraph
from pcore.fitting.limb import (
    Limb,
    about,
    after,
    bent,
    first_bends,
    limbs_of,
    places_after,
    turned_by,
)
from pcore.fitting.point_splatting import PointSplatting

_LIMBS = 10
_FIRST = 1000
_KEPT = 20
_TIMES = 10
_ANGLES = (0.5, 0.25, 0.12, 0.06)
"""Turns by which kept guesses are varied, radians, one round after the other."""
_WHOLE = 1.0, 0.3
"""First turn of the whole object, radians, and its way by its size for every radian."""
_CAREFUL = 3
"""Sweeps that change only the one limb that helps most: others might take its place."""
_GAIN = 0.01
"""Share of the error by which a change must lower it."""

Errors = Callable[[AnchorPose], float]
"""Error of a pose in pictures as they are drawn."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LimbSearch:
    """What a search needs.

    Attributes:
        graph: of the anchors.
        splatting: compares many poses in little time.
        error: judges the few that are best there.
        sweeps: over all limbs, at most.
        seed: of the guesses.
    """

    graph: AnchorGraph
    splatting: PointSplatting
    error: Errors
    sweeps: int
    seed: int

    def found(self, start: AnchorPose, told: Callable[[], None]) -> AnchorPose:
        """Return the best pose; told after every sweep, or as often if fewer are needed."""
        draw = torch.Generator().manual_seed(self.seed)
        limbs = limbs_of(self.graph, _LIMBS)
        motions, error = _motions(start), self.error(start)
        for sweep in range(self.sweeps):
            before = error
            motions, error = self._better([self._carried(motions, draw)], motions, error)
            if sweep < _CAREFUL:
                tried = [self._swung(limb, motions, draw) for limb in limbs]
                motions, error = self._better(tried, motions, error)
            else:
                for limb in limbs:
                    tried = [self._swung(limb, motions, draw)]
                    motions, error = self._better(tried, motions, error)
            told()
            if error > (1 - _GAIN) * before:
                for _ in range(sweep + 1, self.sweeps):
                    told()
                break
        return self._pose(motions)

    def _pose(self, motions: Tensor) -> AnchorPose:
        rest = self.graph.rest.float()
        return AnchorPose(
            rest=rest, moved=places_after(motions, rest), rotations=motions[..., :3].contiguous()
        )

    def _better(self, tried: list[Tensor], motions: Tensor, error: float) -> tuple[Tensor, float]:
        errors = [self.error(self._pose(one)) for one in tried]
        least = min(errors)
        if least < (1 - _GAIN) * error:
            return tried[errors.index(least)], least
        return motions, error

    def _swung(self, limb: Limb, motions: Tensor, draw: torch.Generator) -> Tensor:
        """Motions (M, 3, 4) with a limb bent as the points fit best."""
        bends = first_bends(limb, _FIRST, draw)
        errors = self.splatting.errors(bent(limb, bends, motions))
        for angle in _ANGLES:
            best = errors.argsort(stable=True)[:_KEPT]
            bends = bends[best].varied(_TIMES, angle, draw)
            errors = self.splatting.errors(bent(limb, bends, motions))
        return bent(limb, bends[errors.argmin()[None]], motions)[0]

    def _carried(self, motions: Tensor, draw: torch.Generator) -> Tensor:
        """Motions (M, 3, 4) with the whole object moved as the points fit best."""
        center = places_after(motions, self.graph.rest.float()).mean(dim=0)
        size = float((self.graph.rest - self.graph.rest.mean(dim=0)).norm(dim=1).max())
        whole = torch.eye(3, 4).repeat(_KEPT, 1, 1)
        for angle in (_WHOLE[0], *_ANGLES):
            whole = torch.cat([whole, *self._moves(whole, angle, center, size, draw)])
            errors = self.splatting.errors(after(whole.unsqueeze(1), motions))
            whole = whole[errors.argsort(stable=True)[:_KEPT]]
        return after(whole[0], motions)

    def _moves(
        self, whole: Tensor, angle: float, center: Tensor, size: float, draw: torch.Generator
    ) -> Iterator[Tensor]:
        """Motions (K, 3, 4) of the whole object near those given: turns, ways, and both."""
        for kind in range(_TIMES):
            turns = turned_by(angle, (len(whole),), draw)
            shift = _WHOLE[1] * angle * size * torch.randn(len(whole), 3, 1, generator=draw)
            move = about(turns if kind % 3 else torch.eye(3).expand_as(turns), center)
            move = torch.cat([move[..., :3], move[..., 3:] + shift * (kind % 3 != 1)], dim=-1)
            yield after(move, whole)


def _motions(pose: AnchorPose) -> Tensor:
    """Motions (M, 3, 4) of space by the anchors of a pose."""
    return torch.cat([pose.rotations, pose.translations.unsqueeze(-1)], dim=-1).float().cpu()
