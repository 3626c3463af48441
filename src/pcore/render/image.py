"""The one class of pictures, and the normals of one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.model.hits import Hits

_SOLID = 0.5
_STEEPEST = math.tan(math.radians(80))


@dataclass(frozen=True, kw_only=True)
class Image:
    """A picture, or a batch of them, on the device of the points and of their dtype.

    Attributes:
        rgb: (..., H, W, 3) colours over the background, not clamped.
        alpha: (..., H, W) opacity in [0, 1].
        depth: (..., H, W) camera z of the surface, world units; of rays without a camera the
            distance from where they begin. NaN where nothing is hit.
        surface: (..., H, W, 3) where the surface is, world units; NaN where nothing is hit.
        hits: what each of the rays of all pixels hits; None where nobody asked for it.
    """

    rgb: Tensor
    alpha: Tensor
    depth: Tensor
    surface: Tensor
    hits: Hits | None = None

    def __repr__(self) -> str:
        return f"Image({' x '.join(map(str, self.alpha.shape))} pixels)"

    @property
    def ray_hits(self) -> Hits:
        """What each ray hits; InputError of images that do not keep it."""
        if self.hits is None:
            raise InputError(
                "image: expected what its rays hit, which only `asset.trace` of neural points "
                "keeps, got a picture without; trace rays instead of rendering cameras"
            )
        return self.hits

    @property
    def spread(self) -> Tensor:
        """(..., H, W) mean of `Hits.spread` over the rays of a pixel."""
        return self.ray_hits.spread.reshape(*self.alpha.shape, -1).mean(dim=-1)

    def each(self, change: Callable[[Tensor], Tensor]) -> Image:
        """Return the picture with every plane changed, without what rays hit."""
        return Image(
            rgb=change(self.rgb),
            alpha=change(self.alpha),
            depth=change(self.depth),
            surface=change(self.surface),
        )

    def cpu(self) -> Image:
        """Return the picture on the CPU, cut off from the autograd graph."""
        return self.each(lambda plane: plane.detach().cpu())

    @classmethod
    def stack(cls, images: Sequence[Image]) -> Image:
        """Make a batch of pictures of one size."""
        return cls(
            rgb=torch.stack([one.rgb for one in images]),
            alpha=torch.stack([one.alpha for one in images]),
            depth=torch.stack([one.depth for one in images]),
            surface=torch.stack([one.surface for one in images]),
        )


def normals(image: Image, camera: Camera) -> Tensor:
    """Unit normals (H, W, 3) of the predicted surface, world axes, facing the camera.

    They are the cross product of central differences of the surface points. NaN at the border,
    where the pixel or a neighbour is not solid (alpha below 0.5), and across jumps of depth:
    where the surface would be steeper than 80 degrees to the image plane.

    Args:
        image: one picture.
        camera: that took it.
    """
    points, depth = image.surface, image.depth
    out = torch.full_like(points, math.nan)
    if min(depth.shape) < 3:
        return out
    known = _smooth(image, camera).unsqueeze(-1)
    # Zeros, since autograd would carry what is not known to the pixels beside.
    right = (points[1:-1, 2:] - points[1:-1, :-2]).where(known, 0.0)
    down = (points[2:, 1:-1] - points[:-2, 1:-1]).where(known, 0.0)
    normal = torch.linalg.cross(right, down, dim=-1)
    known = known & (normal.detach().square().sum(dim=-1, keepdim=True) > 0)
    normal = normal / normal.where(known, 1.0).norm(dim=-1, keepdim=True)
    towards = camera.center.to(points) - points[1:-1, 1:-1]
    side = torch.where((normal * towards).detach().sum(dim=-1, keepdim=True) < 0, -1.0, 1.0)
    out[1:-1, 1:-1] = torch.where(known, side * normal, math.nan)
    return out


def _smooth(image: Image, camera: Camera) -> Tensor:
    """Where a pixel and its four neighbours are one surface, (H - 2, W - 2)."""
    solid, depth = image.alpha >= _SOLID, image.depth
    center = depth[1:-1, 1:-1]
    valid = solid[1:-1, 1:-1]
    for rows, columns in (
        (slice(1, -1), slice(2, None)),
        (slice(1, -1), slice(None, -2)),
        (slice(2, None), slice(1, -1)),
        (slice(None, -2), slice(1, -1)),
    ):
        valid = valid & solid[rows, columns] & _one_surface(depth[rows, columns], center, camera)
    return valid


def _one_surface(beside: Tensor, center: Tensor, camera: Camera) -> Tensor:
    """Whether depths of neighbouring pixels are of one surface."""
    # A pixel is depth / focal length wide.
    steepest = _STEEPEST / min(camera.focal)
    return (beside - center).abs() <= steepest * torch.maximum(beside, center)


def whole_normals(image: Image, camera: Camera) -> Tensor:
    """Unit normals (H, W, 3) for pictures: those of `normals`, without gaps at rims and jumps.

    Where only one side of a pixel is of its surface, the difference to that side is taken. NaN
    where the picture is not solid, and where no side is.

    Args:
        image: one picture.
        camera: that took it.
    """
    points = F.pad(image.surface, (0, 0, 1, 1, 1, 1), value=math.nan)
    depth = F.pad(image.depth, (1, 1, 1, 1), value=math.nan)
    solid = F.pad(image.alpha, (1, 1, 1, 1)) >= _SOLID

    def difference(axis: int) -> tuple[Tensor, Tensor]:
        """Along an axis (H, W, 3), and where either side of a pixel tells it (H, W)."""
        total = torch.zeros_like(image.surface)
        told = torch.zeros_like(image.alpha, dtype=torch.bool)
        center = depth[1:-1, 1:-1]
        for step in (-1, 1):
            beside, there, opaque = (
                plane.roll(-step, axis)[1:-1, 1:-1] for plane in (depth, points, solid)
            )
            same = opaque & solid[1:-1, 1:-1] & _one_surface(beside, center, camera)
            total += (step * (there - image.surface)).where(same.unsqueeze(-1), 0.0)
            told |= same
        return total, told

    (down, tall), (right, wide) = difference(0), difference(1)
    normal = F.normalize(torch.linalg.cross(right, down, dim=-1), dim=-1)
    towards = camera.center.to(points) - image.surface
    side = torch.where((normal * towards).sum(dim=-1, keepdim=True) < 0, -1.0, 1.0)
    known = (tall & wide & (normal.square().sum(dim=-1) > 0)).unsqueeze(-1)
    found = normals(image, camera)
    return found.where(~found.isnan(), (side * normal).where(known, math.nan))
