"""PAPR: points and rays in, a rendering out. The middle of the house."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import torch
from torch import Tensor, nn

from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.model.attention import Attended, ProximityAttention
from pcore.model.far_side import opaque, replaced, turned, unanswered
from pcore.model.papr_config import PaprConfig
from pcore.model.sight import Sight, look, look_behind
from pcore.model.strangers import OPAQUE, behind
from pcore.model.surface import surface_of
from pcore.model.unet import Unet

_LEAST_OPACITY = 1e-6


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """What PAPR says about the rays of (H, W) pixels; R is (H, W), or (H, W, S) with S per pixel.

    Attributes:
        rgb: (H, W, 3) colours over the background, not clamped.
        alpha: (H, W) opacity, 1 - attention of the background; mean of the pixel's rays.
        surface: (*R, 3) predicted surface points, world units.
        weights: (*R, k) weights of the neighbours, zero where none is within the cut-off.
        neighbours: (*R, k) indices into the cloud.
        features: (H, W, C) input of the renderer network, mean of the pixel's rays.
        behind: (H, W) weighted mean squared distance of the points behind the first of them; mean
            of the pixel's rays.
    """

    rgb: Tensor
    alpha: Tensor
    surface: Tensor
    weights: Tensor
    neighbours: Tensor
    features: Tensor
    behind: Tensor


class Papr(nn.Module):
    """The networks of PAPR; the points are passed in."""

    def __init__(self, config: PaprConfig) -> None:
        super().__init__()
        self.config = config
        self.attention = ProximityAttention(config)
        self.unet = Unet(config.value.size, config.unet_channels)

    def forward(
        self, cloud: PointCloud, rays: RayBundle, background: Tensor | None = None
    ) -> Rendering:
        """Render the rays of (H, W) pixels.

        Args:
            cloud: the points, canonical or deformed.
            rays: (H, W) rays, or (H, W, S) with S of them per pixel, world units.
            background: (3,) colour behind the object; None takes the configured one.

        Returns:
            The rendering, differentiable in the cloud and the networks.
        """
        shape = rays.shape
        pixels_first = RayBundle(
            origins=rays.origins.flatten(0, 1), directions=rays.directions.flatten(0, 1)
        )
        attended, neighbours = self.attend(cloud, pixels_first)
        gains = self._gains(cloud, pixels_first.flat(), attended, neighbours)
        pixels = averaged(attended, gains, math.prod(shape[2:]))
        features, alpha = pixels.features.reshape(*shape[:2], -1), pixels.alpha.reshape(shape[:2])
        gain = None if pixels.gain is None else pixels.gain.reshape(shape[:2])
        return Rendering(
            rgb=self.shade(features, alpha, background, gain),
            alpha=alpha,
            surface=attended.surface.reshape(*shape, 3),
            weights=attended.weights.reshape(*shape, -1),
            neighbours=neighbours.reshape(*shape, -1),
            features=features,
            behind=pixels.behind.reshape(shape[:2]),
        )

    def attend(
        self, cloud: PointCloud, rays: RayBundle, threshold: float = 0.0
    ) -> tuple[Attended, Tensor]:
        """Nearest points and attention of rays; rays beyond the cut-off cost nothing.

        Args:
            cloud: the points.
            rays: (R,) rays, or (P, S) rays of P pixels, which share a search; R = P * S.
            threshold: points with less than this weight add nothing to a feature; 0 is exact.

        Returns:
            The attention of (R,) rays, and the neighbours (R, k).
        """
        sight, met = self._meet(cloud, rays, threshold)
        cutoff = self.config.cutoff
        if cutoff is None:
            return met, sight.neighbours
        if sight.hidden is not None:
            sight, met = self._closed(cloud, rays.flat(), sight, met, threshold, cutoff)
        return _scatter(met, sight.near, sight.neighbours.shape), sight.neighbours

    def _gains(
        self, cloud: PointCloud, rays: RayBundle, attended: Attended, neighbours: Tensor
    ) -> Tensor | None:
        """Factors (R,) on the brightness of what rays met; None in the light of the photos.

        Losses have no use for where pictures meet the surface, so nothing else looks for it here.
        """
        if cloud.skin is None or cloud.skin.gains is None:
            return None
        return surface_of(cloud, rays, attended, neighbours, self.config.cutoff).gains

    def _closed(
        self,
        cloud: PointCloud,
        rays: RayBundle,
        sight: Sight,
        met: Attended,
        threshold: float,
        cutoff: float,
    ) -> tuple[Sight, Attended]:
        """Look along those of (R,) rays that see through the object from their other ends.

        Returns:
            What they look at and met with those replaced for which the other end says something.
        """
        near, lines = sight.near, rays[sight.near]
        rows = unanswered(met, sight.neighbours[near], cloud, lines, cutoff)
        if len(rows) == 0:
            return sight, met
        there, back = self._meet(cloud, turned(lines[rows], cloud), threshold)
        solid = opaque(back)
        turned_near, rows = there.near[solid], rows[there.near[solid]]
        neighbours = sight.neighbours.index_copy(0, near[rows], there.neighbours[turned_near])
        return replace(sight, neighbours=neighbours), replaced(met, rows, back, solid)

    def _meet(self, cloud: PointCloud, rays: RayBundle, threshold: float) -> tuple[Sight, Attended]:
        """What rays (R,) or (P, S) look at, and the attention of those near to points."""
        config = self.config
        sight = look(cloud, rays, config.neighbours, config.cutoff)
        lines, neighbours = rays.flat(), sight.neighbours
        if config.cutoff is not None:
            lines, neighbours = lines[sight.near], neighbours[sight.near]
        met = self._attend_to(cloud, lines, neighbours, sight.seen, threshold)
        if sight.hidden is None:
            return sight, met
        seen_through = sight.hidden.strangers & (met.background > 1 - OPAQUE)
        rows = torch.nonzero(seen_through).squeeze(-1)
        if len(rows) == 0:
            return sight, met
        others, seen = look_behind(cloud, sight.hidden, rows, config.neighbours)
        back = self._attend_to(cloud, lines[rows], others, seen, threshold)
        met, neighbours = behind(met, neighbours, rows, back, others)
        neighbours = sight.neighbours.index_copy(0, sight.near, neighbours)
        return replace(sight, neighbours=neighbours), met

    def _attend_to(
        self,
        cloud: PointCloud,
        rays: RayBundle,
        neighbours: Tensor,
        seen: RayBundle,
        threshold: float,
    ) -> Attended:
        """Attention of (R,) rays to neighbours (R, k) that see them as `seen`."""
        reference = self.config.reference
        if reference is not None:
            seen = seen.slid(_constant(reference.center, cloud.positions), reference.distance)
        return self.attention(cloud, rays, neighbours, seen, threshold)

    def shade(
        self,
        features: Tensor,
        alpha: Tensor,
        background: Tensor | None = None,
        gain: Tensor | None = None,
    ) -> Tensor:
        """Colours (H, W, 3) of a feature map over a background.

        Args:
            features: (H, W, C).
            alpha: (H, W) opacity.
            background: (3,) colour; None takes the configured one.
            gain: (H, W) factor on the object's brightness; None leaves it as it is.
        """
        colours: Tensor = self.unet(features.permute(2, 0, 1).unsqueeze(0))[0].permute(1, 2, 0)
        if background is None:
            background = _constant(self.config.background, colours)
        if gain is not None:
            colours = colours * gain.unsqueeze(-1)
        opacity = alpha.unsqueeze(-1)
        return colours * opacity + background * (1 - opacity)


@dataclass(frozen=True, kw_only=True)
class Pixels:
    """Means over the rays of P pixels: what colours are made of.

    Attributes:
        features: (P, C) input of the renderer network.
        alpha: (P,) opacity.
        gain: (P,) factor on the object's brightness; None where the light is that of the photos.
        behind: (P,) weighted mean squared distance of the points behind the first of them.
    """

    features: Tensor
    alpha: Tensor
    gain: Tensor | None
    behind: Tensor


def averaged(attended: Attended, gains: Tensor | None, samples: int) -> Pixels:
    """Average R = P * S rays over P pixels, whose S rays follow one another.

    Args:
        attended: what the rays met.
        gains: (R,) factor on the brightness of what they met; None leaves it as it is.
        samples: S.
    """

    def mean(values: Tensor) -> Tensor:
        return values.unflatten(0, (-1, samples)).mean(dim=1)

    opacity = 1 - attended.background
    alpha = mean(opacity)
    gain = None if gains is None else mean(opacity * gains) / alpha.clamp_min(_LEAST_OPACITY)
    return Pixels(
        features=mean(attended.features), alpha=alpha, gain=gain, behind=mean(attended.behind)
    )


def _constant(values: tuple[float, ...], like: Tensor) -> Tensor:
    return _sent_once(values, like.dtype, like.device)


@lru_cache(maxsize=64)
def _sent_once(values: tuple[float, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """Numbers on a device; sending them there makes it wait, so it is done once."""
    return torch.tensor(values, dtype=dtype, device=device)


def _scatter(part: Attended, rows: Tensor, shape: torch.Size) -> Attended:
    """Spread the attended rays over all R rays; the others are pure background."""

    def spread(values: Tensor, fill: float) -> Tensor:
        full = values.new_full((shape[0], *values.shape[1:]), fill)
        return full.index_copy(0, rows, values)

    return Attended(
        features=spread(part.features, 0.0),
        background=spread(part.background, 1.0),
        weights=spread(part.weights, 0.0),
        surface=spread(part.surface, 0.0),
        behind=spread(part.behind, 0.0),
    )
