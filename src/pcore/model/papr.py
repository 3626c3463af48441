"""PAPR: points and rays in, a rendering out. The middle of the house."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.kernels.functional import nearest_to_rays, pull_back
from pcore.model.attention import Attended, ProximityAttention
from pcore.model.config import PaprConfig
from pcore.model.unet import Unet

_CANDIDATES = 2
"""Candidates of the plain search per neighbour: the nearest in the rest state are among them."""


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """What PAPR says about an (H, W) bundle of rays.

    Attributes:
        rgb: (H, W, 3) colours over the background, not clamped.
        alpha: (H, W) opacity, 1 - attention of the background.
        surface: (H, W, 3) predicted surface points, world units.
        weights: (H, W, k) weights of the neighbours, zero where none is within the cut-off.
        neighbours: (H, W, k) indices into the cloud.
        features: (H, W, C) input of the renderer network.
        behind: (H, W) weighted mean squared distance of the points behind the first of them.
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
        """Render an (H, W) bundle of rays.

        Args:
            cloud: the points, canonical or deformed.
            rays: (H, W) rays, world units.
            background: (3,) colour behind the object; None takes the configured one.

        Returns:
            The rendering, differentiable in the cloud and the networks.
        """
        height, width = rays.shape
        attended, neighbours = self.attend(cloud, rays.flat())
        alpha = 1 - attended.background
        features = attended.features.reshape(height, width, -1)
        return Rendering(
            rgb=self.shade(features, alpha.reshape(height, width), background),
            alpha=alpha.reshape(height, width),
            surface=attended.surface.reshape(height, width, 3),
            weights=attended.weights.reshape(height, width, -1),
            neighbours=neighbours.reshape(height, width, -1),
            features=features,
            behind=attended.behind.reshape(height, width),
        )

    def attend(self, cloud: PointCloud, rays: RayBundle) -> tuple[Attended, Tensor]:
        """Nearest points and attention of (R,) rays; rays beyond the cut-off cost nothing."""
        neighbours, seen = self._see(cloud, rays)
        if self.config.cutoff is None:
            return self.attention(cloud, rays, neighbours, seen), neighbours
        near = _within(cloud, neighbours, seen, self.config.cutoff)
        part = self.attention(cloud, rays[near], neighbours[near], seen[near])
        return _scatter(part, near, neighbours.shape), neighbours

    def _see(self, cloud: PointCloud, rays: RayBundle) -> tuple[Tensor, RayBundle]:
        """Neighbours (R, k), and the rays as the networks see them: (R,), or (R, k) with frames."""
        k, frames, reference = self.config.neighbours, cloud.frames, self.config.reference
        positions = cloud.positions.detach()
        if frames is None:
            seen = rays
            neighbours = nearest_to_rays(rays.origins, rays.directions, positions, k)
        else:
            candidates = nearest_to_rays(rays.origins, rays.directions, positions, _CANDIDATES * k)
            neighbours, origins, directions = pull_back(
                rays.origins,
                rays.directions,
                positions,
                frames.rest,
                frames.to_rest,
                candidates,
                min(k, len(cloud)),
            )
            seen = RayBundle(origins=origins, directions=directions)
        if reference is not None:
            seen = seen.slid(positions.new_tensor(reference.center), reference.distance)
        return neighbours, seen

    def shade(self, features: Tensor, alpha: Tensor, background: Tensor | None = None) -> Tensor:
        """Colours (H, W, 3) of a feature map (H, W, C) over a background (3,)."""
        colours: Tensor = self.unet(features.permute(2, 0, 1).unsqueeze(0))[0].permute(1, 2, 0)
        if background is None:
            background = colours.new_tensor(self.config.background)
        opacity = alpha.unsqueeze(-1)
        return colours * opacity + background * (1 - opacity)


def _within(cloud: PointCloud, neighbours: Tensor, seen: RayBundle, cutoff: float) -> Tensor:
    """Indices of the rays that have a point within the cut-off."""
    with torch.no_grad():
        # Neighbours come nearest first, so the first decides.
        first = seen if len(seen.shape) == 1 else seen[:, 0]
        rest = cloud.positions if cloud.frames is None else cloud.frames.rest
        offset = rest[neighbours[:, 0]] - first.origins
        along = (offset * first.directions).sum(dim=-1, keepdim=True)
        distance = (offset - along * first.directions).square().sum(dim=-1)
        return torch.nonzero(distance <= cutoff**2).squeeze(-1)


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
