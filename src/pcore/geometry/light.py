"""A light that stays where it is while an object is edited.

Photos have the light baked into their colours, and an edit carries it along: a side that is turned
downwards stays as bright as it was. With an estimate of the light, every deformed point gets the
factor by which the light on it changes (docs/guide/light.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.errors import InputError
from pcore.geometry.local_frames import LocalFrames

ENCODING = 2.2
"""Exponent between the brightness that a photo stores and light; that of sRGB, nearly."""
LARGEST_GAIN = 2.5
"""No point becomes brighter or darker by more than this factor: beyond, an estimate is no help."""
_DARKEST = 1e-3


@dataclass(frozen=True, kw_only=True)
class Light:
    """Light from far away, the same for all of an object; no shadows.

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


@dataclass(frozen=True, kw_only=True)
class Shading:
    """What it takes to light deformed points anew.

    Attributes:
        light: that of the photos.
        normals: (N, 3) unit normals of the canonical points, world axes; zero where none is known.
    """

    light: Light
    normals: Tensor

    def __post_init__(self) -> None:
        if self.normals.dim() != 2 or self.normals.shape[1] != 3:
            raise InputError(f"shading: expected normals (N, 3), got {tuple(self.normals.shape)}")

    @property
    def known(self) -> Tensor:
        """(N,) bool, the points whose normal is known."""
        return self.normals.square().sum(dim=1) > 0.25

    def gains(self, frames: LocalFrames) -> Tensor:
        """Factor (N,) on the stored brightness of every deformed point; 1 where none is known.

        Args:
            frames: local frames of the deformed points, which say how their normals turn.

        Raises:
            InputError: frames of another number of points.
        """
        if len(frames.rest) != len(self.normals):
            raise InputError(
                f"shading: expected frames of its {len(self.normals)} points, got "
                f"{len(frames.rest)}; estimate the light anew (`pcore light RUN`)"
            )
        # A normal turns by the transposed inverse of the local map, which the frames hold.
        normals = self.normals.to(frames.to_rest)
        turned = F.normalize(torch.einsum("nji,nj->ni", frames.to_rest, normals), dim=1)
        before, after = (
            self.light.irradiance(one).clamp_min(_DARKEST) for one in (normals, turned)
        )
        gains = (after / before).pow(1 / ENCODING).clamp(1 / LARGEST_GAIN, LARGEST_GAIN)
        return torch.where(self.known.to(gains.device), gains, 1.0)
