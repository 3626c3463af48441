"""A light that stays where it is while an object is edited.

Photos have the light baked into their colours, and an edit carries it along: a side that is turned
downwards stays as bright as it was. With an estimate of the light, every deformed point gets the
factor by which the light on it changes (docs/guide/light.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.errors import InputError
from pcore.geometry.local_frames import LocalFrames
from pcore.geometry.neighbours import nearest
from pcore.geometry.shadows import unshadowed
from pcore.geometry.visibility import cloud_spacing

ENCODING = 2.2
"""Exponent between the brightness that a photo stores and light; that of sRGB, nearly."""
LARGEST_GAIN = 2.5
"""No point becomes brighter or darker by more than this factor: beyond, an estimate is no help."""
_DARKEST = 1e-3
_AROUND = 0.4
"""Share of the light from a direction that reaches what is hidden from it, off other surfaces."""
_BESIDE = 16
"""Points whose changes are averaged. Both chosen on objects of our own (ADR 11)."""


@dataclass(frozen=True, kw_only=True)
class Light:
    """Light from far away, the same for all of an object.

    Attributes:
        directions: (D, 3) unit, towards where it comes from; evenly over the sphere.
        radiance: (D,) how much comes from there, at least 0; only ratios matter.
    """

    directions: Tensor
    radiance: Tensor

    def __post_init__(self) -> None:
        shapes = tuple(self.directions.shape), tuple(self.radiance.shape)
        count = shapes[0][0]
        if count == 0 or shapes != ((count, 3), (count,)):
            raise InputError(
                f"light: expected directions (D, 3) and radiance (D,), got {shapes[0]}, {shapes[1]}"
            )
        if not bool((self.radiance >= 0).all()) or float(self.radiance.sum()) <= 0:
            raise InputError("light: expected radiance of 0 or more, and some of it above 0")

    def irradiance(self, normals: Tensor) -> Tensor:
        """Light (N,) that falls on normals (N, 3); 1 where all radiance is 1."""
        return irradiance_of(normals, self.directions) @ self.radiance.to(normals)


def irradiance_of(normals: Tensor, directions: Tensor) -> Tensor:
    """Light (N, D) that falls on normals (N, 3) from each of D directions (D, 3)."""
    # The mean cosine over the hemisphere's sphere is 1 / 4.
    return (normals @ directions.to(normals).T).clamp_min(0) * (4.0 / len(directions))


def known_normals(normals: Tensor) -> Tensor:
    """(N,) bool, which normals (N, 3) are known: of unit length, not zero."""
    return normals.square().sum(dim=1) > 0.25


def reaching(points: Tensor, directions: Tensor, spacing: float) -> Tensor:
    """Share (N, D) of the light from D directions that reaches points (N, 3) past the others.

    See `pcore.geometry.shadows.unshadowed`; what is hidden gets some of it off other surfaces.
    """
    return _AROUND + (1 - _AROUND) * unshadowed(points, directions, spacing)


def spacing_of(points: Tensor) -> float:
    """How far points (N, 3) lie apart for `reaching`, world units; one alone hides nothing."""
    return cloud_spacing(points) if len(points) > 1 else 0.0


@dataclass(frozen=True, kw_only=True)
class Shading:
    """What it takes to light deformed points anew.

    Attributes:
        light: that of the photos.
        normals: (N, 3) unit normals of the canonical points, world axes; zero where none is known.
        positions: (N, 3) canonical points, world units; all float32 on the CPU.
    """

    light: Light
    normals: Tensor
    positions: Tensor

    def __post_init__(self) -> None:
        shapes = tuple(self.normals.shape), tuple(self.positions.shape)
        if shapes[0][1:] != (3,) or shapes[0] != shapes[1]:
            raise InputError(
                f"shading: expected normals (N, 3) and positions (N, 3), got {shapes[0]} and "
                f"{shapes[1]}"
            )
        for one in (self.normals, self.positions):
            if one.dtype != torch.float32 or one.device.type != "cpu":
                raise InputError(
                    f"shading: expected float32 on the CPU, got {one.dtype} on {one.device}"
                )

    @property
    def known(self) -> Tensor:
        """(N,) bool, the points whose normal is known."""
        return known_normals(self.normals)

    def gains(self, frames: LocalFrames, moved: Tensor) -> Tensor:
        """Factor (N,) on the stored brightness of every deformed point.

        It is the mean, of the logarithm, over a point's neighbours at rest whose normal is known
        and does not point the other way; 1 where there are none.

        Args:
            frames: local frames of the deformed points, which say how their normals turn.
            moved: (N, 3) the deformed points, finite, world units.

        Raises:
            InputError: frames of other points, points of another number, NaN or infinity.
        """
        self._check(frames, moved)
        to_rest = frames.to_rest.detach().cpu().float()
        # A normal turns by the transposed inverse of the local map, which the frames hold.
        turned = F.normalize(torch.einsum("nji,nj->ni", to_rest, self.normals), dim=1)
        place = moved.detach().cpu().float()
        light = self._falling(place, turned, self._spacing * frames.growth)
        change = (light / self._at_rest).log() / ENCODING
        beside, counts = self._beside
        mean = (change[beside] * counts).sum(dim=1) / counts.sum(dim=1).clamp_min(1)
        return mean.exp().clamp(1 / LARGEST_GAIN, LARGEST_GAIN).to(moved.device)

    def _check(self, frames: LocalFrames, moved: Tensor) -> None:
        counts = len(frames.rest), len(moved)
        if counts != (len(self.normals),) * 2:
            raise InputError(
                f"shading: expected frames of its {len(self.normals)} points and where they are, "
                f"got {counts[0]} and {counts[1]}; estimate the light anew (`pcore light RUN`)"
            )
        if not torch.equal(frames.rest.detach().cpu().float(), self.positions):
            raise InputError(
                "shading: expected frames from the points that the light was estimated with, got "
                "others; deform the canonical cloud"
            )
        bad = int((~torch.isfinite(moved).all(dim=1)).sum())
        if bad:
            raise InputError(
                f"shading: expected finite points, got NaN or infinity in {bad} of {len(moved)}"
            )

    def _falling(self, points: Tensor, normals: Tensor, spacing: float) -> Tensor:
        """Light (N,) on points (N, 3), so far apart, with normals (N, 3); never nothing at all."""
        reach = reaching(points, self.light.directions, spacing)
        falling = irradiance_of(normals, self.light.directions) * reach
        darkest = _DARKEST * float(self.light.radiance.mean())
        return (falling @ self.light.radiance).clamp_min(darkest)

    @cached_property
    def _at_rest(self) -> Tensor:
        """Light (N,) on the points at rest."""
        return self._falling(self.positions, self.normals, self._spacing)

    @cached_property
    def _beside(self) -> tuple[Tensor, Tensor]:
        """Indices (N, 16) of the nearest points at rest, a point itself among them, and 1 or 0.

        1 counts: the normal is known and does not point the other way, as that of the other side of
        a thin sheet would, which is in another light.
        """
        beside = nearest(self.positions, self.positions, _BESIDE)[0]
        alike = torch.einsum("nkc,nc->nk", self.normals[beside], self.normals) >= 0
        return beside, (self.known[beside] & alike).to(self.normals)

    @cached_property
    def _spacing(self) -> float:
        return spacing_of(self.positions)
