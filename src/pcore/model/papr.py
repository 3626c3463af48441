"""PAPR: points and rays in, a rendering out. The middle of the house."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor, nn

from pcore.geometry.local_frames import LocalFrames
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.kernels.functional import nearest_to_rays, pull_back
from pcore.model.attention import Attended, ProximityAttention
from pcore.model.config import PaprConfig
from pcore.model.strangers import OPAQUE, behind, strangers, without
from pcore.model.unet import Unet

_CANDIDATES = 1.25
_MOST_CANDIDATES = 64
"""Candidates of the plain search, per neighbour and unit of the frames' condition number, and in
all (what the search on CUDA takes). A circle around an ellipse is larger by the ratio of its axes:
among so many times more are the nearest of the rest state, were all spread evenly. See ADR 5."""
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
        attended, neighbours = self.attend(cloud, rays.flat())
        pixels = averaged(cloud, attended, neighbours, math.prod(shape[2:]))
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
        """Nearest points and attention of (R,) rays; rays beyond the cut-off cost nothing.

        Args:
            cloud: the points.
            rays: (R,) rays, world units.
            threshold: points with less than this weight add nothing to a feature; 0 is exact.

        Returns:
            The attention, and the neighbours (R, k).
        """
        neighbours, near, seen = self._see(cloud, rays)
        if near is None:
            return self._attend(cloud, rays, neighbours, seen, threshold), neighbours
        part = self._attend(cloud, rays[near], neighbours[near], seen, threshold)
        return _scatter(part, near, neighbours.shape), neighbours

    def _attend(
        self,
        cloud: PointCloud,
        rays: RayBundle,
        neighbours: Tensor,
        seen: RayBundle,
        threshold: float,
    ) -> Attended:
        """Attention of (R,) rays to neighbours (R, k) that see them as `seen`.

        With frames and a cut-off, points that met no ray together at rest are layered by depth.
        """
        frames, cutoff = cloud.frames, self.config.cutoff
        if frames is None or cutoff is None or cloud.moved_as_one:
            return self.attention(cloud, rays, neighbours, seen, threshold)
        rest = frames.rest[neighbours]
        others = strangers(cloud.positions.detach()[neighbours], rest, rays, seen, cutoff)
        if not bool(others.any()):
            return self.attention(cloud, rays, neighbours, seen, threshold)
        alone = without(rest, seen, others, cutoff)
        front = self.attention(cloud, rays, neighbours, alone, threshold)
        seen_through = others.any(dim=1) & (front.background > 1 - OPAQUE)
        rows = torch.nonzero(seen_through).squeeze(-1)
        if len(rows) == 0:
            return front
        alone = without(rest[rows], seen[rows], ~others[rows], cutoff)
        back = self.attention(cloud, rays[rows], neighbours[rows], alone, threshold)
        return behind(front, rows, back)

    def _see(self, cloud: PointCloud, rays: RayBundle) -> tuple[Tensor, Tensor | None, RayBundle]:
        """What the networks are to look at.

        Returns:
            Neighbours (R, k) of all rays; indices (M,) of the rays with a point within the cut-off,
            None for all; these rays as the networks see them: (M,), or (M, k) with frames.
        """
        cutoff, k, reference = self.config.cutoff, self.config.neighbours, self.config.reference
        positions, frames = cloud.positions.detach(), cloud.frames
        near: Tensor | None = None
        if frames is None:
            neighbours, seen = nearest_to_rays(rays.origins, rays.directions, positions, k), rays
            if cutoff is not None:
                near = _reached(positions, neighbours, rays, cutoff)
                seen = rays[near]
        else:
            # The nearest in the rest state are sought among more than k of the deformed state.
            neighbours, near, seen = _pulled_back(positions, frames, rays, k, cutoff)
        if reference is not None:
            seen = seen.slid(_constant(reference.center, positions), reference.distance)
        return neighbours, near, seen

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
        gain: (P,) factor on the object's brightness; None where no point has one.
        behind: (P,) weighted mean squared distance of the points behind the first of them.
    """

    features: Tensor
    alpha: Tensor
    gain: Tensor | None
    behind: Tensor


def averaged(cloud: PointCloud, attended: Attended, neighbours: Tensor, samples: int) -> Pixels:
    """Average R = P * S rays over P pixels, whose S rays follow one another."""

    def mean(values: Tensor) -> Tensor:
        return values.unflatten(0, (-1, samples)).mean(dim=1)

    opacity = 1 - attended.background
    alpha, gain = mean(opacity), None
    if cloud.gains is not None:
        of_rays = (attended.weights * cloud.gains[neighbours]).sum(dim=-1)
        gain = mean(opacity * of_rays) / alpha.clamp_min(_LEAST_OPACITY)
    return Pixels(
        features=mean(attended.features), alpha=alpha, gain=gain, behind=mean(attended.behind)
    )


def _constant(values: tuple[float, ...], like: Tensor) -> Tensor:
    return _sent_once(values, like.dtype, like.device)


@lru_cache(maxsize=64)
def _sent_once(values: tuple[float, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """Numbers on a device; sending them there makes it wait, so it is done once."""
    return torch.tensor(values, dtype=dtype, device=device)


def _pulled_back(
    positions: Tensor, frames: LocalFrames, rays: RayBundle, k: int, cutoff: float | None
) -> tuple[Tensor, Tensor | None, RayBundle]:
    """Neighbours (R, k), near rays (M,) or None, and these rays (M, k) of the rest state."""
    count = _candidates(frames, k)
    candidates = nearest_to_rays(rays.origins, rays.directions, positions, count)
    k = min(k, len(positions))
    near: Tensor | None = None
    if cutoff is not None:
        # No point is farther from a ray in the deformed state than so many times in the rest state.
        reach = cutoff * frames.stretch[candidates].amax(dim=1)
        near = _reached(positions, candidates, rays, reach)
    some = rays if near is None else rays[near]
    chosen, origins, directions = pull_back(
        some.origins,
        some.directions,
        positions,
        frames.rest,
        frames.to_rest,
        candidates if near is None else candidates[near],
        k,
    )
    seen = RayBundle(origins=origins, directions=directions)
    if near is None or cutoff is None:
        return chosen, None, seen
    answered = _reached(frames.rest, chosen, seen[:, 0], cutoff)
    near = near[answered]
    return candidates[:, :k].index_copy(0, near, chosen[answered]), near, seen[answered]


def _candidates(frames: LocalFrames, k: int) -> int:
    """How many candidates are looked at for k neighbours."""
    return max(k, math.ceil(min(_CANDIDATES * frames.anisotropy * k, _MOST_CANDIDATES)))


@torch.no_grad()
def _reached(
    points: Tensor, neighbours: Tensor, rays: RayBundle, distance: Tensor | float
) -> Tensor:
    """Indices of the (R,) rays whose first, nearest neighbour (R, k) is within a distance (R,)."""
    offset = points[neighbours[:, 0]] - rays.origins
    along = (offset * rays.directions).sum(dim=-1, keepdim=True)
    squared = (offset - along * rays.directions).square().sum(dim=-1)
    return torch.nonzero(squared <= distance**2).squeeze(-1)


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
