"""One surface out of the depth of many pictures (Curless and Levoy 1996).

Every voxel near the surface gets the mean of its signed distances from what the pictures show
there, cut off at a few voxels; the surface is where that is zero. Pixels that show nothing speak,
too: what a camera looks through is empty, which sweeps away whatever floats. A voxel that no camera
has seen is inside, so that the surface can be closed where nobody has looked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.render.distance_grid import BoolArray, DistanceGrid, require_marching_cubes
from pcore.render.image import Image, normals
from pcore.render.surfel_fit import Shown

_SOLID = 0.5
_BLOCK = 5
"""Voxels along a side of the blocks that are looked at or left out as a whole."""
_BAND = 4.0
"""Voxels at which distances are cut off; less than a block, so that one block around suffices."""
_JUMP = 6.0
"""Voxels by which four neighbouring pixels may differ and still be one surface: 80 degrees steep
where a pixel is a voxel wide."""
_LEAST_COSINE = 0.1
_RIM = 0.15
"""Cosine of pixels at the rim of the object, whose normal is not known."""
FREE = 0.05
"""Weight of a ray that passes, beside the cosine of one that hits: many pass close to a surface and
would push it inwards; enough of them sweep away what floats."""
_CHUNK = 1 << 18


@dataclass(frozen=True, kw_only=True)
class DepthView(Shown):
    """What a camera shows of a surface.

    Attributes:
        cosine: (H, W) between the surface and the way to the camera; 0 where that is not known.
    """

    cosine: Tensor


def depth_view(image: Image, camera: Camera) -> DepthView:
    """Keep of a picture what a surface is made of.

    Args:
        image: one picture on the CPU, over black.
        camera: that took it.
    """
    solid = (image.alpha >= _SOLID) & image.depth.isfinite()
    towards = torch.nn.functional.normalize(camera.center - image.surface, dim=-1)
    cosine = (normals(image, camera) * towards).sum(dim=-1).nan_to_num(_RIM) * solid
    depth = image.depth.masked_fill(~solid, math.nan)
    straight = image.rgb / image.alpha.clamp_min(_SOLID).unsqueeze(-1)
    return DepthView(camera=camera, rgb=straight, depth=depth, cosine=cosine.clamp(0, 1))


def fuse(
    views: Sequence[DepthView],
    lower: Tensor,
    upper: Tensor,
    voxel: float,
    *,
    smooth: float = 1.0,
    closed: bool = False,
) -> tuple[Tensor, Tensor]:
    """Make the mesh that the pictures agree on; see `fused_distances` and `DistanceGrid.surface`.

    Returns:
        Vertices (V, 3) float64 and faces (F, 3) int64, counter-clockwise from outside.

    Raises:
        InputError: no picture shows anything solid in the box.
        DependencyError: scikit-image is not installed.
    """
    require_marching_cubes()
    return fused_distances(views, lower, upper, voxel, smooth=smooth, closed=closed).surface()


@torch.no_grad()
def fused_distances(
    views: Sequence[DepthView],
    lower: Tensor,
    upper: Tensor,
    voxel: float,
    *,
    smooth: float = 1.0,
    closed: bool = False,
    free: float = FREE,
) -> DistanceGrid:
    """Average the distances from the surface that pictures show.

    Args:
        views: at least one, with pixels about a voxel wide.
        lower: (3,) corner of the box to look in, world units.
        upper: (3,) the other corner.
        voxel: side of a voxel, world units.
        smooth: standard deviation, voxels, of a filter over the distances: pictures of a learned
            object do not agree to a voxel on where its surface is. 0 is none.
        closed: end the surface nowhere: what no camera has seen is inside. Else it ends there.
        free: weight of a ray that passes. Where voxels are so large that the object is thinner
            than the distances that count, 1: what lies behind it was seen to be empty.

    Raises:
        InputError: no picture shows anything solid in the box.
    """
    grid = _Grid.around(lower, upper, voxel)
    near = grid.blocks_of([_places(view) for view in views])
    if not near.any():
        raise InputError(
            f"mesh: expected pictures of a solid surface, got none in {len(views)} view(s) in the "
            "box that is meshed; was the run trained to its end, and do the cameras see it?"
        )
    near = _with_neighbours(near)
    coarse = _far_away(grid, views, ~near, free)
    if closed:
        # Where free and unseen space meet far from any surface there is a surface now.
        near |= _borders(coarse, near)
    field, seen = grid.spread(coarse, near, views, free)
    # Outside of all pictures is no part of the object.
    field[~seen] = np.where(field[~seen] > 0, 1.0, -1.0)
    shown = None if closed else seen & (field < 1.0)
    values = np.asarray(gaussian_filter(field, smooth), dtype=np.float32)
    return DistanceGrid(values=values, shown=shown, lower=grid.lower, voxel=voxel)


@dataclass(frozen=True, kw_only=True)
class _Grid:
    """Voxels by their centres: lower + voxel * (i, j, k)."""

    lower: Tensor
    voxel: float
    blocks: tuple[int, int, int]

    @classmethod
    def around(cls, lower: Tensor, upper: Tensor, voxel: float) -> _Grid:
        lower, upper = lower.double().cpu(), upper.double().cpu()
        count = ((upper - lower) / (voxel * _BLOCK)).ceil().long().clamp_min(1) + 2
        first, second, third = count.tolist()
        slack = (count * _BLOCK * voxel - (upper - lower)) / 2
        return cls(lower=lower - slack, voxel=voxel, blocks=(first, second, third))

    def blocks_of(self, places: Sequence[Tensor]) -> BoolArray:
        """Blocks that hold any of these places (P, 3)."""
        found = np.zeros(self.blocks, dtype=np.bool_)
        for some in places:
            index = ((some - self.lower) / self.voxel / _BLOCK + 0.5 / _BLOCK).floor().long()
            inside = ((index >= 0) & (index < torch.tensor(self.blocks))).all(dim=1)
            found[tuple(index[inside].T.numpy())] = True
        return found

    def centers(self, block: NDArray[np.int64]) -> Tensor:
        """Middles (M, 3) of blocks (M, 3)."""
        steps = torch.from_numpy(block) * _BLOCK + 0.5 * (_BLOCK - 1)
        return self.lower + self.voxel * steps

    def spread(
        self, coarse: NDArray[np.float32], near: BoolArray, views: Sequence[DepthView], free: float
    ) -> tuple[NDArray[np.float32], BoolArray]:
        """Field and whether it was seen, of all voxels: each its own where blocks are near."""
        sides = tuple(_BLOCK * side for side in self.blocks)
        block = np.argwhere(near)
        steps = np.stack(np.meshgrid(*3 * [np.arange(_BLOCK)], indexing="ij"), -1).reshape(-1, 3)
        values = np.repeat(coarse.reshape(-1, 1), _BLOCK**3, axis=1)
        rows = np.flatnonzero(near)
        for part in np.array_split(np.arange(len(rows)), 1 + len(rows) * _BLOCK**3 // _CHUNK):
            voxel = torch.from_numpy((_BLOCK * block[part, None] + steps).reshape(-1, 3))
            own = _distances(self.lower + self.voxel * voxel, views, self.voxel, free)
            values[rows[part]] = own.numpy().reshape(len(part), -1)
        cubes = values.reshape(*self.blocks, _BLOCK, _BLOCK, _BLOCK).transpose(0, 3, 1, 4, 2, 5)
        field = np.ascontiguousarray(cubes).reshape(sides)
        return field, np.isfinite(field)


def _places(view: DepthView) -> Tensor:
    """Surface points (P, 3) float64 of a view."""
    rays = view.camera.rays()
    forward = -view.camera.world_from_camera[:3, 2]
    steps = view.depth / (rays.directions @ forward)
    solid = view.depth.isfinite()
    return (rays.origins[solid] + rays.directions[solid] * steps[solid].unsqueeze(-1)).double()


def _far_away(
    grid: _Grid, views: Sequence[DepthView], which: BoolArray, free: float
) -> NDArray[np.float32]:
    """The field at the middles of these blocks, which are no surface; NaN where not seen."""
    found = np.full(grid.blocks, np.nan, dtype=np.float32)
    middles = grid.centers(np.argwhere(which))
    found[which] = _distances(middles, views, grid.voxel, free).numpy()
    # The mean of a block's middle, far from any surface, stands for which side it is on.
    return np.where(np.isfinite(found), np.sign(found), found)


def _borders(coarse: NDArray[np.float32], near: BoolArray) -> BoolArray:
    """Blocks of unseen space beside free ones, and those beside them."""
    free = (coarse > 0) & ~near
    unseen = ~free & ~near
    return (_with_neighbours(free) & unseen) | (_with_neighbours(unseen) & free)


def _with_neighbours(blocks: BoolArray) -> BoolArray:
    return np.asarray(binary_dilation(blocks, np.ones((3, 3, 3))), dtype=np.bool_)


def _distances(places: Tensor, views: Sequence[DepthView], voxel: float, free: float) -> Tensor:
    """Means (M,) over views of distances of places (M, 3) from the surface, in bands.

    Positive outside; NaN where no view tells, infinity outside of all pictures.
    """
    total, weight = torch.zeros(len(places)), torch.zeros(len(places))
    framed = torch.zeros(len(places), dtype=torch.bool)
    for view in views:
        value, sure, inside = _told(places.float(), view, voxel, free)
        total += value * sure
        weight += sure
        framed |= inside
    mean = torch.where(weight > 0, total / weight.clamp_min(1e-9), math.nan)
    return torch.where(framed, mean, math.inf)


def _told(
    places: Tensor, view: DepthView, voxel: float, weight: float
) -> tuple[Tensor, Tensor, Tensor]:
    """What one view says of places (M, 3): distances in bands, weights, and if it frames them."""
    camera, band = view.camera, _BAND * voxel
    column, row, z = camera.project(places)
    inside = (z > 0) & (column >= 0) & (column < camera.width)
    inside &= (row >= 0) & (row < camera.height)
    column, row = column.nan_to_num(0.0), row.nan_to_num(0.0)
    here = _pixel(view.depth, row.floor(), column.floor())
    cosine = _pixel(view.cosine, row.floor(), column.floor())
    depth, spread = _between(view.depth, row - 0.5, column - 0.5)
    smooth = spread <= _JUMP * voxel
    depth = torch.where(smooth, depth, here)
    # Along the ray, then across the surface.
    x, y = (column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy
    ahead = (depth - z) * (1 + x * x + y * y).sqrt()
    distance = ahead * cosine.clamp_min(_LEAST_COSINE)
    empty = here.isnan()
    free = empty | (distance > band)
    told = smooth & (cosine > _LEAST_COSINE) & (distance > -band)
    value = torch.where(free, 1.0, (distance / band).clamp(-1, 1)).nan_to_num(1.0)
    return value, torch.where(free, weight, cosine * told) * inside, inside


def _pixel(plane: Tensor, row: Tensor, column: Tensor) -> Tensor:
    """Values (M,) of a plane (H, W) at rows and columns, those beyond it of the rim."""
    height, width = plane.shape
    return plane[row.long().clamp(0, height - 1), column.long().clamp(0, width - 1)]


def _between(plane: Tensor, row: Tensor, column: Tensor) -> tuple[Tensor, Tensor]:
    """Bilinear values (M,) between pixels' centres, and how far the known of the four are apart."""
    top, left = row.floor(), column.floor()
    down, right = row - top, column - left
    corners = [_pixel(plane, top + i, left + j) for i in (0, 1) for j in (0, 1)]
    four = torch.stack(corners)
    shares = torch.stack([(1 - down) * (1 - right), (1 - down) * right, down * (1 - right)])
    shares = torch.cat([shares, (down * right)[None]]).masked_fill(four.isnan(), 0.0)
    # At the rim those that there are.
    mean = (shares * four.nan_to_num(0.0)).sum(dim=0) / shares.sum(dim=0)
    least, most = four.nan_to_num(math.inf).amin(dim=0), four.nan_to_num(-math.inf).amax(dim=0)
    return mean, torch.where(mean.isnan(), math.inf, most - least)
