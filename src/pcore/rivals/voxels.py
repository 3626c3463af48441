"""A radiance field of voxels (Fridovich-Keil et al. 2022), warped by a cage as Deforming-NeRF does.

Density and spherical harmonics on the corners of a grid, between them linear. Only corners in and
around the object have a row of numbers; elsewhere is nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.deform.cage import Cage, CageDeform
from pcore.gaussians.spherical_harmonics import colors
from pcore.geometry.camera import Camera
from pcore.render.image import Image

DEGREE = 2
_STEP = 0.5
"""Distance of samples along a ray, in voxels; theirs is 0.5."""
_WARP = 40
"""Grid points along the longest side on which the way back through a cage is known."""
_RAYS = 4096
_TRACE = 1e-6

Warp = Callable[[Tensor], tuple[Tensor, Tensor]]
"""Places (M, 3) of an edited scene -> where they are at rest, and which are anywhere (M,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class VoxelGrid:
    """Which corners of a grid have a row.

    Attributes:
        index: (X, Y, Z) int64, row of each corner; the last row, of nothing, for all others.
        lower: (3,) the first corner, world units.
        step: between corners, world units.
    """

    index: Tensor
    lower: Tensor
    step: float

    @property
    def upper(self) -> Tensor:
        """(3,) the last corner."""
        return self.lower + self.step * (torch.tensor(self.index.shape) - 1)

    def near(self, points: Tensor) -> Tensor:
        """Which points (M, 3) have a corner with a row nearest to them."""
        cell = ((points - self.lower) / self.step).round().long()
        size = torch.tensor(self.index.shape)
        inside = ((cell >= 0) & (cell < size)).all(dim=-1)
        x, y, z = cell.clamp_min(0).minimum(size - 1).unbind(-1)
        return inside & (self.index[x, y, z] < self.rows)

    @property
    def rows(self) -> int:
        """How many corners have a row."""
        return int(self.index.max())

    def at(self, values: Tensor, points: Tensor) -> Tensor:
        """Interpolate rows (rows + 1, C) at points (M, 3) inside: (M, C)."""
        place = (points - self.lower) / self.step
        size = torch.tensor(self.index.shape)
        cell = place.floor().long().clamp_min(0).minimum(size - 2)
        part = (place - cell).clamp(0, 1)
        total = values.new_zeros(len(points), values.shape[1])
        for corner in range(8):
            shift = torch.tensor([corner >> 2 & 1, corner >> 1 & 1, corner & 1])
            x, y, z = (cell + shift).unbind(-1)
            weight = torch.where(shift == 1, part, 1 - part).prod(dim=-1, keepdim=True)
            total = total + weight * values[self.index[x, y, z]]
        return total


@dataclass(frozen=True, kw_only=True, eq=False)
class VoxelField:
    """What was learned.

    Attributes:
        grid: where.
        values: (rows + 1, 1 + 3 (DEGREE + 1)^2) density in 1 / voxel and harmonics; zeros last.
    """

    grid: VoxelGrid
    values: Tensor

    def draw(self, camera: Camera, warp: Warp | None = None) -> Image:
        """Take a picture on white, as it was trained or through a warp."""
        rays = camera.rays().flat()
        parts = [
            march(self, rays.origins[i : i + _RAYS], rays.directions[i : i + _RAYS], warp)
            for i in range(0, len(rays.origins), _RAYS)
        ]
        rgb, alpha, along = (torch.cat(one) for one in zip(*parts, strict=True))
        shape = (camera.height, camera.width)
        forward = -camera.world_from_camera[:3, 2]
        depth = torch.where(alpha > _TRACE, along * (rays.directions @ forward), torch.nan)
        surface = rays.origins + along[:, None] * rays.directions
        return Image(
            rgb=(rgb + 1 - alpha[:, None]).reshape(*shape, 3),
            alpha=alpha.reshape(shape),
            depth=depth.reshape(shape),
            surface=surface.reshape(*shape, 3),
        )


def march(
    field: VoxelField, origins: Tensor, directions: Tensor, warp: Warp | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Colours (R, 3) over black, opacity (R,) and mean distance (R,) of rays; differentiable.

    Views of warped samples are seen along the differences of samples that follow one another.
    """
    grid = field.grid
    middle = (grid.lower + grid.upper) / 2
    reach = float((grid.upper - grid.lower).norm()) / 2 * (1.0 if warp is None else _WIDER)
    step = _STEP * grid.step
    ahead = ((middle - origins) * directions).sum(dim=-1, keepdim=True)
    count = int(2 * reach / step) + 1
    distances = ahead - reach + step * (torch.arange(count) + 0.5)
    distances = distances.clamp_min(0)
    places = origins[:, None] + distances[..., None] * directions[:, None]
    shape, flat = places.shape[:2], places.reshape(-1, 3)
    seen = directions[:, None].expand_as(places).reshape(-1, 3)
    if warp is None:
        kept = grid.near(flat)
    else:
        flat, kept = warp(flat)
        seen = _differences(flat.reshape(*shape, 3), directions).reshape(-1, 3)
        kept = kept & grid.near(flat)
    chosen = kept.nonzero().squeeze(-1)
    found = grid.at(field.values, flat[chosen])
    density = torch.zeros(len(flat)).index_put((chosen,), found[:, 0].clamp_min(0))
    light = colors(found[:, 1:].reshape(len(chosen), (DEGREE + 1) ** 2, 3), seen[chosen])
    thickness = _STEP * density.reshape(shape)
    clear = torch.exp(-F.pad(thickness.cumsum(dim=1), (1, 0))[:, :-1])
    weights = clear * (1 - torch.exp(-thickness))
    alpha = weights.sum(dim=1)
    shares = weights.reshape(-1)[chosen, None] * light
    rgb = torch.zeros(shape[0], 3).index_add(0, chosen // shape[1], shares)
    along = (weights * distances).sum(dim=1) / alpha.clamp_min(_TRACE)
    return rgb, alpha, along


_WIDER = 2.5
"""How much farther than at rest an edited object may reach."""


def _differences(places: Tensor, directions: Tensor) -> Tensor:
    """Unit directions (R, S, 3) between warped samples; the ray's own where they do not move."""
    ahead = F.pad(places[:, 1:] - places[:, :-1], (0, 0, 0, 1))
    ahead[:, -1] = directions
    length = ahead.norm(dim=-1, keepdim=True)
    return torch.where(length > 1e-9, ahead / length.clamp_min(1e-9), directions[:, None])


def cage_warp(vertices: Tensor, faces: Tensor, moved: Tensor) -> Warp:
    """The way back through a cage: mean value coordinates in the DEFORMED cage, put on the rest.

    Theirs are harmonic by default; mean value ones are one of their options. They are computed on
    a grid and linear between, as theirs are.

    Args:
        vertices: (V, 3) of the cage at rest, world units.
        faces: (F, 3).
        moved: (V, 3) after the edit.
    """
    cage = Cage(vertices=moved, faces=faces)
    low, high = moved.amin(dim=0), moved.amax(dim=0)
    step = float((high - low).max()) / _WARP
    counts = ((high - low) / step).ceil().long() + 1
    axes = [low[i] + step * torch.arange(int(counts[i])) for i in range(3)]
    grid = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1)
    flat = grid.reshape(-1, 3).double()
    way = (CageDeform(cage, vertices.double()).displaced(flat) - flat).float()
    held = cage.holds(flat).float()
    volume = torch.cat([way, held[:, None]], dim=1).reshape(*grid.shape[:3], 4)
    volume = volume.permute(3, 0, 1, 2)[None]
    size = step * (counts - 1)

    def warp(points: Tensor) -> tuple[Tensor, Tensor]:
        where = 2 * (points - low) / size - 1
        # The sampler counts its axes from the last.
        found = F.grid_sample(
            volume, where.flip(-1)[None, None, None], align_corners=True, padding_mode="zeros"
        )
        moves = found[0, :, 0, 0].T
        return points + moves[:, :3], moves[:, 3] > 0.5

    return warp
