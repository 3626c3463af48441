"""What tells that an edit is going wrong.

Strain, thin places, surface that meets itself, surface that no training view saw.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.neighbours import nearest
from pcore.geometry.visibility import cloud_spacing, seen_by

NEIGHBOURS = 8
THIN = 2.0
"""Growth of the distance to the `NEIGHBOURS`-th nearest point from which a place counts as thin."""
APART = 5.0
"""Points this many spacings apart are no neighbours: where they become so, the surface meets."""

_CALM, _STRETCHED, _SQUEEZED = (0.82, 0.82, 0.82), (0.84, 0.15, 0.12), (0.13, 0.36, 0.78)
_MEETING, _EXPOSED = (0.75, 0.1, 0.75), (0.98, 0.74, 0.02)


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnosis:
    """What an edit did to the neighbourhood of every point.

    Attributes:
        strain: (N,) largest growth of the distance to one of the 8 nearest points before; 1 is
            none, 2 twice as far.
        thinning: (N,) growth of the distance to the 8th nearest point, whichever that is.
        meeting: (N,) bool; another part of the surface came as near as neighbours are.
        exposed: (N,) bool; no training camera saw the point at rest and one of them would see it
            now; None where the training cameras are not known.
    """

    strain: Tensor
    thinning: Tensor
    meeting: Tensor
    exposed: Tensor | None = None

    @property
    def hole_score(self) -> float:
        """Share of the points around which the cloud is less than half as dense in length."""
        return float((self.thinning > THIN).double().mean())

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
            "self_intersection": self.self_intersection,
            **({} if exposed is None else {"exposed": exposed}),
        }

    def colors(self) -> Tensor:
        """Colours (N, 3) uint8: grey is calm, red stretched to twice, blue halved, violet meets.

        Between them by the logarithm of the strain. Yellow is exposed, whatever its strain.
        """
        share = torch.log2(self.strain.float().clamp(0.5, 2.0)).unsqueeze(-1)
        calm, red, blue = map(torch.tensor, (_CALM, _STRETCHED, _SQUEEZED))
        end = torch.where(share > 0, red, blue)
        colors = calm + share.abs() * (end - calm)
        for where, paint in ((self.exposed, _EXPOSED), (self.meeting, _MEETING)):
            if where is not None:
                colors = torch.where(where.unsqueeze(-1), torch.tensor(paint), colors)
        return (255 * colors).round().to(torch.uint8)


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
    now = (moved[index] - moved.unsqueeze(1)).norm(dim=-1)
    # Points in one place have no distance that could grow.
    tiny = 1e-9 * (rest.amax(dim=0) - rest.amin(dim=0)).norm() + torch.finfo(torch.float64).tiny
    growth = torch.where(near > tiny, now / near.clamp_min(tiny), 0.0)
    strain = growth.amax(dim=1)
    strain = torch.where(strain > 0, strain, 1.0)
    found, close = nearest(moved, moved, NEIGHBOURS + 1)
    apart = (rest[found] - rest.unsqueeze(1)).norm(dim=-1)
    spacing, spacing_now = near[:, 1:].mean(dim=1), now[:, 1:].mean(dim=1)
    meets = (close < spacing_now.unsqueeze(1)) & (apart > APART * spacing.unsqueeze(1))
    return Diagnosis(
        strain=strain,
        thinning=close[:, -1] / near[:, -1].clamp_min(tiny),
        meeting=meets.any(dim=1),
    )


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
