"""Small pictures of points without gradients, by which thousands of poses are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.deform.skinning import SkinningWeights
from pcore.fitting.fit_photos import Photo
from pcore.gaussians.pinhole import view_matrices
from pcore.gaussians.render import PosedGaussians
from pcore.gaussians.spherical_harmonics import colors
from pcore.kernels.cpu_point_pictures import picture_errors

_SOLID = 0.5
_THERE = 0.1
"""A pixel shows the object from this opacity on: a point is drawn in all of the pixel it is in."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PointSplatting:
    """A cloud and the photos that its poses are compared with, all on the CPU.

    Attributes:
        points: (N, 3) at rest, world units.
        owners: (N,) the anchor that carries each most.
        colors: (N, 3).
        cameras: (V, 3, 4) homogeneous pixels from world.
        photos: (V, H, W, 5) colours, whether the object is there, whether the pixel is known.
        color_weight: of colours against outlines.
    """

    points: Tensor
    owners: Tensor
    colors: Tensor
    cameras: Tensor
    photos: Tensor
    color_weight: float

    @classmethod
    def of(
        cls,
        look: PosedGaussians,
        rest: Tensor,
        weights: SkinningWeights,
        photos: Sequence[Photo],
        *,
        count: int,
        seed: int,
        silhouettes: bool,
    ) -> PointSplatting:
        """Choose points of Gaussians.

        Args:
            look: gives opacities and colours.
            rest: (N, 3) means at rest.
            weights: of the Gaussians.
            photos: of the size to compare at.
            count: points at most.
            seed: of the choice of points.
            silhouettes: leave the colours out.
        """
        solid = (look.gaussians.opacities > _SOLID).nonzero()[:, 0].cpu()
        draw = torch.Generator().manual_seed(seed)
        chosen = solid[torch.randperm(len(solid), generator=draw)[:count]]
        seen = colors(look.gaussians.sh[:, :1], look.gaussians.means)
        if look.gains is not None:
            seen = seen * look.gains
        heaviest = weights.values.cpu()[chosen].argmax(dim=1, keepdim=True)
        views, lenses = view_matrices([photo.camera for photo in photos], rest.cpu())
        return cls(
            points=rest.cpu()[chosen].contiguous(),
            owners=weights.anchors.cpu()[chosen].gather(1, heaviest)[:, 0],
            colors=seen.cpu()[chosen].contiguous(),
            cameras=(lenses @ views[:, :3]).contiguous(),
            photos=_table(photos),
            color_weight=0.0 if silhouettes else 1.0,
        )

    def errors(self, motions: Tensor) -> Tensor:
        """Errors (B,) of rigid motions (B, M, 3, 4) of the anchors, in pixels of the photos."""
        found = picture_errors(
            self.points.numpy(),
            self.owners.numpy(),
            self.colors.numpy(),
            motions.float().contiguous().numpy(),
            self.cameras.numpy(),
            self.photos.numpy(),
            self.color_weight,
        )
        return torch.from_numpy(found)


def _table(photos: Sequence[Photo]) -> Tensor:
    """Photos (V, H, W, 5); what smaller ones lack is not known."""
    height, width = (max(photo.alpha.shape[k] for photo in photos) for k in (0, 1))
    table = torch.zeros(len(photos), height, width, 5)
    for row, photo in zip(table, photos, strict=True):
        alpha = photo.alpha.cpu()
        part = row[: alpha.shape[0], : alpha.shape[1]]
        part[..., :3] = photo.color.cpu() / alpha.clamp_min(_THERE).unsqueeze(-1)
        part[..., 3] = (alpha > _THERE).float()
        part[..., 4] = (photo.known.cpu() > 0.5).float()
    return table
