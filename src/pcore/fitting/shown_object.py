"""Gaussians that show an object while its pose is looked for: its own, or others in its place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.asset.asset import Asset, Posed
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.splats_of_points import splats_of_points
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint, PosedGaussians, pose
from pcore.geometry.neighbours import nearest

Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Shown:
    """An object and Gaussians that show it.

    Attributes:
        asset: the object, whose points edits move.
        gaussians: G of them at rest, on the device that does the work.
        footprint: how they meet pixels.
        owners: (G,) the point that carries each; None: they are the points, one by one.
    """

    asset: Asset
    gaussians: Gaussians
    footprint: Footprint
    owners: Tensor | None = None

    @classmethod
    def of(cls, asset: Asset, progress: Progress | None = None) -> Shown:
        """Take the Gaussians of an object, or fit some to the pictures of one of neural points.

        Args:
            asset: the object. Where the scene it learned from is on this machine, pictures of
                neural points are taken from the cameras of its photos, else from all around.
            progress: told (pictures and steps done, all of them), where some are fitted.
        """
        content = asset.content
        if isinstance(content, GaussianContent):
            own = content.gaussians.detached()
            return cls(asset=asset, gaussians=own, footprint=content.footprint)
        cameras = None
        if asset.record.scene_folder is not None:
            cameras = [view.camera for view in asset.scene().split("train")]
        fitted = splats_of_points(asset, cameras, progress=progress)
        owners = nearest(asset.points, fitted.gaussians.means, 1)[0][:, 0]
        return cls(
            asset=asset, gaussians=fitted.gaussians, footprint=fitted.footprint, owners=owners
        )

    def rows(self, values: Tensor) -> Tensor:
        """Return what points have (N, ...) for the Gaussians (G, ...)."""
        return values if self.owners is None else values[self.owners.to(values.device)]

    @torch.no_grad()
    def look(self, posed: Posed) -> PosedGaussians:
        """The Gaussians as the points carry them, under the light of the posed object."""
        if self.owners is None:
            drawn: PosedGaussians = posed.content.drawn
            return drawn
        own, linear = self.gaussians, posed.linear
        if linear is None:
            linear = torch.eye(3).expand(len(posed.points), 3, 3)
        maps = self.rows(linear).to(own.means)
        beside = own.means - self.rows(self.asset.points).to(own.means)
        places = self.rows(posed.points).to(own.means) + (maps @ beside.unsqueeze(-1)).squeeze(-1)
        gains = self.asset.gains_of(posed)
        if gains is not None:
            gains = self.rows(gains).to(own.means).unsqueeze(1)
        return pose(own, places, maps, gains)
