"""What tells that an edit is going wrong.

Strain, torn places, surface that meets itself, surface that no training view saw.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from pcore.deform.jacobian import fitted_maps
from pcore.editing.state import EditState
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.neighbours import nearest
from pcore.geometry.point_cloud import size_of
from pcore.geometry.visibility import cloud_spacing, seen_by

NEIGHBOURS = 8
TORN = 2.0
"""Tearing from which aware rays are likely to find a hole."""
THIN = 1.5
"""Strain from which plain rays are likely to find a hole."""
APART = 5.0
"""Points this many spacings apart are no neighbours: where they become so, the surface meets."""

Paint = tuple[float, float, float]
CALM: Paint = (0.82, 0.82, 0.82)
_STRETCHED, _SQUEEZED = (0.84, 0.15, 0.12), (0.13, 0.36, 0.78)
_MEETING, _EXPOSED = (0.75, 0.1, 0.75), (0.98, 0.74, 0.02)
_FEWEST = 4
_HOLE = (0.93, 0.42, 0.05)

Legend = tuple[tuple[str, Paint], ...]
"""What colours mean, in the order in which they are told."""
STRAIN_LEGEND: Legend = (
    ("calm", CALM),
    ("stretched to twice or more", _STRETCHED),
    ("squeezed to half or less", _SQUEEZED),
    ("met another part", _MEETING),
    ("came to light, seen by no training view", _EXPOSED),
)
HOLE_LEGEND: Legend = (
    ("holds together", CALM),
    (f"comes apart: counts in the hole score from a tearing of {TORN:g} on, paler below", _HOLE),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnosis:
    """What an edit did to the neighbourhood of every point.

    Attributes:
        strain: (N,) largest growth of the distance to one of the 8 nearest points before; 1 is
            none, 2 twice as far.
        tearing: (N,) the same growth in the measure of the map that the surface around the point
            follows: |A^-1 (x'_j - x'_i)| / |x_j - x_i| with A fitted to the neighbours, of which
            those that went elsewhere have no say (`estimated_maps`). It is 1 wherever the surface
            grows, shears or turns smoothly, however much; only what comes apart is more.
        meeting: (N,) bool; another part of the surface came as near as neighbours are.
        exposed: (N,) bool; no training camera saw the point at rest and one of them would see it
            now; None where the training cameras are not known.
    """

    strain: Tensor
    tearing: Tensor
    meeting: Tensor
    exposed: Tensor | None = None

    @property
    def hole_score(self) -> float:
        """Share of the points that a neighbour left: where aware rays find holes."""
        return float((self.tearing > TORN).double().mean())

    @property
    def hole_score_plain(self) -> float:
        """Share of the points with a neighbour 1.5 times as far: where plain rays find holes.

        Plain rays do not follow the scale of the surface, so a uniform scale by 2 counts here.
        """
        return float((self.strain > THIN).double().mean())

    @property
    def self_intersection(self) -> float:
        """Share of the points that met another part of the surface."""
        return float(self.meeting.double().mean())

    def numbers(self) -> dict[str, float]:
        """All of it as figures for a report."""
        shares = torch.tensor([0.5, 0.99], dtype=self.strain.dtype)
        middle, high = torch.quantile(self.strain, shares).tolist()
        exposed = None if self.exposed is None else float(self.exposed.double().mean())
        return {
            "strain_median": middle,
            "strain_99": high,
            "strain_max": float(self.strain.max()),
            "hole_score": self.hole_score,
            "hole_score_plain": self.hole_score_plain,
            "self_intersection": self.self_intersection,
            **({} if exposed is None else {"exposed": exposed}),
        }

    def colors(self) -> Tensor:
        """Colours (N, 3) uint8: grey is calm, red stretched to twice, blue halved, violet meets.

        Between them by the logarithm of the strain. Yellow is exposed, whatever its strain.
        """
        colors = shaded(self.strain, more=_STRETCHED, less=_SQUEEZED)
        for where, paint in ((self.exposed, _EXPOSED), (self.meeting, _MEETING)):
            if where is not None:
                colors = torch.where(where.unsqueeze(-1), painted(paint), colors)
        return colors

    def hole_colors(self) -> Tensor:
        """Colours (N, 3) uint8: grey holds together, orange from a tearing of 2 on."""
        return shaded(self.tearing, more=_HOLE, less=CALM)


def painted(paint: Paint) -> Tensor:
    """Return a colour as (3,) uint8."""
    return (255 * torch.tensor(paint)).round().to(torch.uint8)


def shaded(growth: Tensor, *, more: Paint, less: Paint) -> Tensor:
    """Colours (N, 3) uint8 of growths (N,), by their logarithm: one colour at 2, one at 1/2."""
    share = torch.log2(growth.float().clamp(0.5, 2.0)).unsqueeze(-1)
    calm = torch.tensor(CALM)
    end = torch.where(share > 0, torch.tensor(more), torch.tensor(less))
    return (255 * (calm + share.abs() * (end - calm))).round().to(torch.uint8)


def diagnose(before: Tensor, after: Tensor) -> Diagnosis:
    """Compare a cloud before and after an edit.

    Args:
        before: (N, 3) world units, N at least 2.
        after: (N, 3) the same points.

    Raises:
        InputError: clouds of different sizes or fewer than two points.
    """
    if before.shape != after.shape or before.ndim != 2 or len(before) < 2:
        raise InputError(
            "diagnosis: expected the same points (N, 3) twice, at least two, got "
            f"{tuple(before.shape)} and {tuple(after.shape)}"
        )
    rest, moved = before.detach().cpu().double(), after.detach().cpu().double()
    index, near = nearest(rest, rest, NEIGHBOURS + 1)
    offset = moved[index] - moved.unsqueeze(1)
    now, size = offset.norm(dim=-1), size_of(rest)
    # Points in one place have no distance that could grow.
    tiny = 1e-9 * size + torch.finfo(torch.float64).tiny
    strain = _growth(now, near, tiny)
    tearing = torch.ones_like(strain)
    if len(rest) >= _FEWEST and size > 0:
        maps, _ = fitted_maps(rest, moved)
        # All in one place has no way back, and nothing comes apart.
        to_rest = torch.linalg.inv(maps) if bool(maps.any()) else torch.zeros_like(maps)
        tearing = _growth(
            (to_rest.unsqueeze(1) @ offset.unsqueeze(-1)).norm(dim=(2, 3)), near, tiny
        )
    found, close = nearest(moved, moved, NEIGHBOURS + 1)
    apart = (rest[found] - rest.unsqueeze(1)).norm(dim=-1)
    spacing, spacing_now = near[:, 1:].mean(dim=1), now[:, 1:].mean(dim=1)
    meets = (close < spacing_now.unsqueeze(1)) & (apart > APART * spacing.unsqueeze(1))
    return Diagnosis(strain=strain, tearing=tearing, meeting=meets.any(dim=1))


def _growth(now: Tensor, before: Tensor, tiny: float) -> Tensor:
    """Largest ratio (N,) of distances (N, K); 1 where there was none."""
    growth = torch.where(before > tiny, now / before.clamp_min(tiny), 0.0).amax(dim=1)
    return torch.where(growth > 0, growth, 1.0)


def with_exposed(
    found: Diagnosis, before: Tensor, after: Tensor, cameras: Iterable[Camera]
) -> Diagnosis:
    """Add which points an edit brings to light that no training view saw.

    Args:
        found: of the same clouds, from `diagnose`.
        before: (N, 3) world units.
        after: (N, 3) the same points.
        cameras: of the training views.

    Raises:
        InputError: as `diagnose`.
    """
    views, spacing = tuple(cameras), cloud_spacing(before)
    unseen = ~seen_by(before, views, spacing)
    return replace(found, exposed=unseen & seen_by(after, views, spacing))


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
