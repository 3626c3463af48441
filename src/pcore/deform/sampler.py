"""The random deformations that fine-tuning draws (P-CORE, appendix "Range of Deformation")."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeVar

import torch
from torch import Tensor

from pcore.deform.base import Deformation, apply_matrix, orientation
from pcore.deform.frame import perpendicular_frame
from pcore.deform.simple import (
    AxialStretch,
    Bend,
    SimpleDeform,
    Twist,
    VolumeStretch,
    uniform_scale,
)
from pcore.errors import InputError

Turning = TypeVar("Turning", Twist, Bend)

_TRIES = 32
# Below this share of a rigid motion's determinant a map is taken to fold (1e-3: a bend whose inner
# side shrinks to a thousandth is already useless as training signal).
_LEAST_ORIENTATION = 1e-3


@dataclass(frozen=True, kw_only=True)
class DeformationRanges:
    """How far the random deformations of fine-tuning go; magnitudes are uniform in their range."""

    stretch: tuple[float, float] = (1.0, 3.0)
    """Least and greatest length along the direction, as a multiple of the original."""

    twist_degrees: float = 60.0
    """Greatest twist over the object; drawn from both senses."""

    bend_degrees: float = 60.0
    """Greatest bend over the object; drawn from both senses."""

    scale: tuple[float, float] = (0.5, 2.0)
    """Least and greatest uniform scale."""

    scale_share: float = 0.25
    """Chance of a uniform scale; stretch, twist and bend share the rest equally. A quarter makes
    all four alike, as in the paper."""

    profile: Literal["axial", "volume"] = "axial"
    """Cross-section under stretch: "axial" keeps it, "volume" shrinks it so that volume is kept."""

    def __post_init__(self) -> None:
        for name, (least, greatest) in (("stretch", self.stretch), ("scale", self.scale)):
            if not 0 < least <= greatest < math.inf:
                raise InputError(
                    f"deformation ranges: expected 0 < least <= greatest for {name}, "
                    f"got ({least}, {greatest})"
                )
        for name, degrees in (("twist", self.twist_degrees), ("bend", self.bend_degrees)):
            if not 0 <= degrees < math.inf:
                raise InputError(
                    f"deformation ranges: expected {name}_degrees of 0 or more, got {degrees}"
                )
        if not 0 <= self.scale_share <= 1:
            raise InputError(
                f"deformation ranges: expected scale_share in [0, 1], got {self.scale_share}"
            )
        if self.profile not in ("axial", "volume"):
            raise InputError(
                f'deformation ranges: expected profile "axial" or "volume", got {self.profile!r}'
            )


def sample_deformation(
    generator: torch.Generator,
    lower: Tensor,
    upper: Tensor,
    points: Tensor,
    ranges: DeformationRanges,
) -> Deformation:
    """Draw one deformation: stretch, twist, bend or uniform scale.

    It acts about the centre of the bounding box along a direction uniform on the sphere, with the
    extent of the canonical points along that direction, and keeps det J > 0 at all of them: a
    bend that would fold the object is drawn again (other direction and angle), and in the rare
    case that no direction fits its angle is halved until one does.

    Args:
        generator: source of all randomness; a CPU generator gives the same draw everywhere.
        lower: (3,) lower corner of the canonical bounding box, world units.
        upper: (3,) upper corner.
        points: (N, 3) canonical points; the deformation is frozen to their extents.
        ranges: kinds and greatest amounts.

    Raises:
        InputError: no points, or points that all lie in one plane across every drawn direction.
    """
    if points.ndim != 2 or points.shape[-1] != 3 or points.shape[0] == 0:
        raise InputError(
            f"random deformation: expected canonical points (N, 3), got {tuple(points.shape)}"
        )
    points = points.detach()
    center = 0.5 * (lower + upper).detach().double().cpu()
    draws: tuple[Callable[[], Deformation], ...] = (
        lambda: _stretch(generator, center, points, ranges),
        lambda: _turning(Twist, generator, center, points, ranges.twist_degrees),
        lambda: _bend(generator, center, points, ranges.bend_degrees),
    )
    if _uniform(generator, 0.0, 1.0) < ranges.scale_share:
        return uniform_scale(_uniform(generator, *ranges.scale), center)
    return draws[_choice(generator, len(draws))]()


def _stretch(
    generator: torch.Generator, center: Tensor, points: Tensor, ranges: DeformationRanges
) -> Deformation:
    rotation = _frame(generator)
    kind = AxialStretch if ranges.profile == "axial" else VolumeStretch
    return kind(
        rotation=rotation,
        origin=center,
        extent=_extent(points, center, rotation[2]),
        value=_uniform(generator, *ranges.stretch) - 1.0,
    )


def _bend(
    generator: torch.Generator, center: Tensor, points: Tensor, degrees: float
) -> Deformation:
    bend = _turning(Bend, generator, center, points, degrees)
    for _ in range(_TRIES):
        if not _folds(bend, points):
            return bend
        bend = _turning(Bend, generator, center, points, degrees)
    while _folds(bend, points):
        bend = Bend(
            rotation=bend.rotation, origin=center, extent=bend.extent, value=0.5 * bend.value
        )
    return bend


def _turning(
    kind: type[Turning], generator: torch.Generator, center: Tensor, points: Tensor, degrees: float
) -> Turning:
    """A map by an angle, which goes through all of it over the extent of the points."""
    rotation = _frame(generator)
    return kind(
        rotation=rotation,
        origin=center,
        extent=_extent(points, center, rotation[0 if kind is Bend else 2]),
        value=math.radians(_uniform(generator, -degrees, degrees)),
    )


def _folds(deformation: SimpleDeform, points: Tensor) -> bool:
    return bool((orientation(deformation, points) < _LEAST_ORIENTATION).any())


def _frame(generator: torch.Generator) -> Tensor:
    """Orthonormal frame (3, 3), axis and roll about it both uniform."""
    normal = torch.randn(
        2, 3, generator=generator, device=generator.device, dtype=torch.float64
    ).cpu()
    return perpendicular_frame(normal[0], normal[1])


def _extent(points: Tensor, center: Tensor, direction: Tensor) -> tuple[float, float]:
    """Least and greatest coordinate of the points along a direction, from the centre."""
    along = apply_matrix(direction.to(points).expand(1, 3), points - center.to(points))
    lo, hi = torch.aminmax(along)
    return float(lo), float(hi)


def _uniform(generator: torch.Generator, least: float, greatest: float) -> float:
    share = torch.rand((), generator=generator, device=generator.device, dtype=torch.float64)
    return least + (greatest - least) * float(share)


def _choice(generator: torch.Generator, count: int) -> int:
    return int(torch.randint(count, (), generator=generator, device=generator.device))
