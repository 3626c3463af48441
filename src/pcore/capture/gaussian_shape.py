"""The object among Gaussians that were learned of a whole room, and its outlines in pictures.

What stands before the wall, or on the floor, that the cameras look at: the supporting plane is
taken away, and of the rest the dense thing near the middle of the viewing axes is the object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage
from scipy.spatial import KDTree
from torch import Tensor

from pcore.capture.sparse_region import object_points
from pcore.data.poses import closest_to_axes
from pcore.data.sparse import SparsePoints
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.pinhole import surface_points
from pcore.gaussians.render import (
    Footprint,
    PosedGaussians,
    blended,
    render,
)
from pcore.geometry.camera import Camera

_POINTS = 20_000
"""Points of surfaces in all pictures together."""
_SOLID, _STEP = 0.9, 0.05
"""Pixels of less opacity, or beside a step of the depth (as a share), are no surface."""
_THICK = 0.04
"""What is nearer to the supporting plane belongs to it, in distances of the cameras."""
_CARRIES = 0.2
"""Least share of the points that the supporting plane has."""
_BEFORE = 0.95
"""Share of the cameras that stand before it."""
_TRIES, _TRIED = 400, 4000
_OUTLINE, _STEEP = 0.5, 2.0
"""Opacity where the object ends, and how much steeper its rim is made than it is drawn."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GaussianShape:
    """An object of Gaussians.

    Attributes:
        gaussians: the object's.
        footprint: how they meet pixels.
        points: (M, 3) of its surface, world units.
    """

    gaussians: Gaussians
    footprint: Footprint
    points: Tensor

    def mask(self, camera: Camera) -> Tensor:
        """Mask (H, W) in [0, 1] without holes and specks; the object is drawn alone.

        Its rim is as soft as the object is drawn: one rim in space, which all views agree on.
        """
        with torch.no_grad():
            ones = torch.ones(len(self.gaussians), 1)
            opacity = blended(self.gaussians, ones, camera, footprint=self.footprint)[1].numpy()
        solid = ndimage.binary_fill_holes(ndimage.binary_opening(opacity > _OUTLINE))
        labels = np.empty(opacity.shape, dtype=np.int32)
        ndimage.label(solid, output=labels)
        if labels.max() > 1:
            areas = np.bincount(labels.ravel())[1:]
            solid = np.isin(labels, 1 + np.flatnonzero(areas >= 0.1 * areas.max()))
        inner, near = ndimage.binary_erosion(solid, iterations=2), ndimage.binary_dilation(solid)
        rim = np.clip((opacity - _OUTLINE) * _STEEP + 0.5, 0, 1) * near
        return torch.from_numpy(np.where(inner, 1, rim).astype(np.float32))


def find_shape(
    gaussians: Gaussians,
    footprint: Footprint,
    cameras: Sequence[Camera],
    generator: torch.Generator,
) -> GaussianShape | None:
    """Find the object that cameras look at; lengths are measured in their distance.

    Args:
        gaussians: of all that is to be seen, on the CPU.
        footprint: as they were trained.
        cameras: of the training views; in small pictures this takes seconds.
        generator: of the draws.

    Returns:
        None where the axes are parallel, or nothing stands near their middle.
    """
    middle = closest_to_axes(torch.stack([camera.world_from_camera for camera in cameras]))
    if middle is None:
        return None
    centers = torch.stack([camera.center for camera in cameras])
    distance = float((centers - middle.float()).norm(dim=-1).median())
    surface = _surface(gaussians, footprint, cameras, generator)
    heights = _heights(surface, centers, _THICK * distance, generator)
    standing = torch.arange(len(surface))
    if heights is not None:
        standing = (heights > _THICK * distance).nonzero()[:, 0]
    if not len(standing):
        return None
    found = object_points(SparsePoints(positions=surface[standing]), cameras)
    if found is None:
        return None
    # A Gaussian belongs to what the surface nearest to it belongs to.
    of_object = KDTree(found.numpy()).query(surface.numpy())[0] == 0
    nearest = KDTree(surface.numpy()).query(gaussians.means.numpy())[1]
    chosen = torch.from_numpy(of_object[nearest])
    if not bool(chosen.any()):
        return None
    return GaussianShape(
        gaussians=gaussians.each(lambda tensor: tensor[chosen]), footprint=footprint, points=found
    )


@torch.no_grad()
def _surface(
    gaussians: Gaussians,
    footprint: Footprint,
    cameras: Sequence[Camera],
    generator: torch.Generator,
) -> Tensor:
    """Points (P, 3) of surfaces that the pictures show, evenly from all of them."""
    found: list[Tensor] = []
    for camera in cameras:
        picture = render(PosedGaussians(gaussians=gaussians), [camera], footprint=footprint)
        depth, solid = picture.depth[0], picture.alpha[0] > _SOLID
        steps = torch.zeros_like(depth)
        steps[1:-1, 1:-1] = torch.maximum(
            (depth[1:-1, 2:] - depth[1:-1, :-2]).abs(), (depth[2:, 1:-1] - depth[:-2, 1:-1]).abs()
        )
        points = surface_points(depth, camera)[solid & (steps <= _STEP * depth)]
        order = torch.randperm(len(points), generator=generator)
        found.append(points[order[: max(1, _POINTS // len(cameras))]])
    return torch.cat(found)


def _heights(
    points: Tensor, centers: Tensor, thick: float, generator: torch.Generator
) -> Tensor | None:
    """Heights (P,) over the plane that most points lie on and all cameras stand before.

    By random samples of three points (Fischler and Bolles 1981), then by all that lie on it.
    None where no plane carries enough points.
    """
    tried = points[torch.randperm(len(points), generator=generator)[:_TRIED]]
    most, best = _CARRIES * len(tried), None
    for _ in range(_TRIES):
        a, b, c = tried[torch.randint(len(tried), (3,), generator=generator)]
        normal = torch.linalg.cross(b - a, c - a)
        length = normal.norm()
        if float(length) == 0:
            continue
        normal = normal / length
        normal = torch.where(((centers - a) @ normal).median() < 0, -normal, normal)
        on = ((tried - a) @ normal).abs() < thick
        before = ((centers - a) @ normal > thick).float().mean()
        if float(before) >= _BEFORE and float(on.sum()) > most:
            most, best = float(on.sum()), (normal, tried[on])
    if best is None:
        return None
    normal, on = best
    middle = on.mean(dim=0)
    fitted = torch.linalg.svd(on - middle, full_matrices=False).Vh[2]
    fitted = torch.where(fitted @ normal < 0, -fitted, fitted)
    return (points - middle) @ fitted
