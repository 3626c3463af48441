"""What an edit does to every point, quickly enough for while it is dragged.

`pcore.editing.diagnosis` is the careful one: it fits the map around every point. Here it is that
of the edit, and neighbours are found once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from pcore.editing.diagnosis import NEIGHBOURS, Diagnosis
from pcore.editing.state import EditState
from pcore.geometry.camera import Camera
from pcore.geometry.extent import size_of
from pcore.geometry.neighbours import nearest
from pcore.geometry.visibility import cloud_spacing, seen_by


@dataclass(frozen=True, kw_only=True, eq=False)
class LiveDiagnosis:
    """Diagnoses the states of one session.

    Attributes:
        rest: (N, 3) canonical points, world units, at least two.
        cameras: of the training views, for `exposed`; few, since each takes milliseconds.
    """

    rest: Tensor
    cameras: Sequence[Camera] = ()

    def of(self, state: EditState) -> Diagnosis:
        """Strain and tearing of every point; nothing is said to meet or to be exposed."""
        index, before = self._beside
        points = state.points.detach().cpu().double()
        offset = points[index] - points.unsqueeze(1)
        linear = state.bound.linear
        tiny = 1e-9 * size_of(self.rest) + torch.finfo(torch.float64).tiny
        before = before.clamp_min(tiny)
        strain = (offset.norm(dim=2) / before).amax(dim=1)
        # Where a map has no way back the point is strained enough for anything.
        whole = torch.linalg.det(linear).abs() > torch.finfo(torch.float64).tiny
        unit = torch.eye(3, dtype=torch.float64)
        back = torch.linalg.inv(torch.where(whole[:, None, None], linear, unit))
        tearing = (torch.einsum("nij,nkj->nki", back, offset).norm(dim=2) / before).amax(dim=1)
        none = torch.zeros(len(points), dtype=torch.bool)
        return Diagnosis(strain=strain, tearing=tearing, meeting=none)

    def exposed(self, points: Tensor) -> Tensor:
        """Which points, bool (N,), came to light that no training view saw at rest.

        Args:
            points: (N, 3) where they are now, world units.
        """
        return self._unseen & seen_by(points, self.cameras, self._spacing)

    @cached_property
    def _beside(self) -> tuple[Tensor, Tensor]:
        """Neighbours (N, K) at rest, and how far (N, K) they are there."""
        rest = self.rest.detach().cpu().double()
        index, away = nearest(rest, rest, NEIGHBOURS + 1)
        return index[:, 1:], away[:, 1:]

    @cached_property
    def _spacing(self) -> float:
        return cloud_spacing(self.rest)

    @cached_property
    def _unseen(self) -> Tensor:
        return ~seen_by(self.rest, self.cameras, self._spacing)
