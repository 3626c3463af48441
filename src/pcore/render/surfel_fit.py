"""What training photos say about the points of a trained model: surfels over them, and colours.

Points lie a little inside the object: attention does not care how far. Where the surface over them
is, photos tell: at the right height above the points all of them show the same colours there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.data.scene import View
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.geometry.surfels import Surfels, spacing_of
from pcore.model.papr import Papr
from pcore.render.image import Image, normals
from pcore.render.surface import surface_of
from pcore.render.trace import trace

_LARGEST_SIDE = 200
_SOLID = 0.9
_ALIKE = 0.4
"""Shortest mean of the unit normals that views see at a point; at edges they see several sides."""
_SEEN = 0.5
_MOST_VIEWS = 50
"""Views that are compared with one another, at most; evenly among all."""
_FACING = 0.3
"""Least cosine between a normal and the way to a camera that shows its surface well."""
_LIFTS = tuple(0.2 * step for step in range(-1, 8))
"""Heights of the surface above the points that are tried, in spacings."""
_CLOSE, _CLOSEST = 3.0, 2.0
"""Spacings from the predicted depth within which a place is the one that a photo shows: while
heights are tried, and when colours are taken."""
_ENOUGH, _LEAST = 4, 2
"""Photos that must show a place: to tell whether they agree, and to take its colour from them."""
_TOLD, _HALF = 50, 0.5
"""Points that must be told about, the same ones at every height; heights at which photos tell of
less than half as many as at the best are not tried."""
_CLEAR, _BARE = 0.9, 1e-3
"""Share of the largest disagreement that the least one may have, and what that must be: paint
without any pattern agrees with itself at every height."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class Observed:
    """What photos say about N points.

    Attributes:
        normals: (N, 3) unit, outwards; zero where views do not agree on one.
        colors: (N, 3) colour of the surface over a point.
        attention: (N,) sum of the weights that the pixels of all views gave a point.
        heights: (N,) how far above the points the surface lies, along the normals, world units.
    """

    normals: Tensor
    colors: Tensor
    attention: Tensor
    heights: Tensor

    def surfels(self, cloud: PointCloud) -> Surfels:
        """Return the surface over these points, on their device."""
        positions = cloud.positions.detach()
        normals, heights = self.normals.to(positions), self.heights.to(positions)
        return Surfels.at_rest(positions, normals, heights)


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A photo and how far away what it shows is.

    Attributes:
        camera: of the photo.
        rgb: (H, W, 3).
        depth: (H, W) camera z by the model, world units; NaN where nothing solid is seen.
    """

    camera: Camera
    rgb: Tensor
    depth: Tensor


@torch.no_grad()
def observe(
    papr: Papr, cloud: PointCloud, views: Sequence[View], *, progress: Progress | None = None
) -> Observed:
    """Normals, colours and surface of canonical points by all views, on the CPU.

    Views are looked at with at most 200 pixels a side; their number of rays per pixel is one.
    A point whose surface fewer than two of them show has the colour of the pixels that look at it.
    """
    device = next(papr.parameters()).device
    cloud = cloud.detached().to(device)
    posed = PosedCloud.at_rest(cloud)
    sums = torch.zeros(len(cloud), 7)
    kept = compared(len(views))
    shown: list[Shown] = []
    for number, view in enumerate(views, start=1):
        seen = _look(papr, posed, view, sums)
        if number - 1 in kept:
            shown.append(seen)
        if progress is not None:
            progress(number, len(views))
    normal, color, attention = sums[:, :3], sums[:, 3:6], sums[:, 6]
    known = (attention > _SEEN) & (normal.norm(dim=1) > _ALIKE * attention)
    normal = F.normalize(normal, dim=1) * known[:, None]
    positions = cloud.positions.cpu().float()
    spacing = spacing_of(positions)
    lift = spacing * height_of(positions[known], normal[known], shown, spacing)
    around = color / attention.clamp_min(1e-9)[:, None]
    there = colors_at(positions + lift * normal, normal, shown, spacing)
    colors = torch.where(known[:, None] & ~there.isnan(), there, around)
    heights = torch.full_like(attention, lift)
    return Observed(normals=normal, colors=colors, attention=attention, heights=heights)


def compared(count: int) -> set[int]:
    """Numbers of the views, of so many, that are compared with one another."""
    return {count * step // _MOST_VIEWS for step in range(_MOST_VIEWS)}


def height_of(points: Tensor, normals: Tensor, shown: Sequence[Shown], spacing: float) -> float:
    """How far above points the surface lies, in spacings: where photos agree most on its colours.

    Args:
        points: (K, 3) whose normal is known, world units.
        normals: (K, 3) unit.
        shown: the photos.
        spacing: of the points, world units.

    Returns:
        The height at which the median of the colours' standard deviation is least; 0 where photos
        cannot tell: too few show the points, or they agree at every height alike.
    """
    if not shown or len(points) == 0:
        return 0.0
    off = torch.stack(
        [_disagreement(points + h * spacing * normals, normals, shown, spacing) for h in _LIFTS]
    )
    counts = off.isfinite().sum(dim=1)
    tried = torch.nonzero(counts >= _HALF * counts.max()).squeeze(1)
    off = off[tried]
    told = off.isfinite().all(dim=0)
    if int(told.sum()) < _TOLD:
        return 0.0
    curve = off[:, told].median(dim=1).values.tolist()
    if max(curve) < _BARE or min(curve) > _CLEAR * max(curve):
        return 0.0
    return _lowest([_LIFTS[one] for one in tried.tolist()], curve)


def _lowest(places: Sequence[float], heights: Sequence[float]) -> float:
    """Where the parabola through the least of values at places and its neighbours is least."""
    best = min(range(len(heights)), key=heights.__getitem__)
    if best in (0, len(heights) - 1):
        return places[best]
    before, here, after = heights[best - 1 : best + 2]
    bend = before - 2 * here + after
    part = 0.0 if bend == 0 else 0.5 * (before - after) / bend
    return places[best] + part * (places[best + 1] - places[best])


def _disagreement(
    places: Tensor, normals: Tensor, shown: Sequence[Shown], spacing: float
) -> Tensor:
    """Standard deviation (K,) of the colours that photos show at places; NaN where too few do."""
    stacked = torch.stack([_colors(places, normals, one, _CLOSE * spacing) for one in shown])
    count = (~stacked[..., 0].isnan()).sum(dim=0)
    off = (stacked - stacked.nanmean(dim=0)).square().nanmean(dim=0).mean(dim=1).sqrt()
    return torch.where(count >= _ENOUGH, off, math.nan)


def colors_at(places: Tensor, normals: Tensor, shown: Sequence[Shown], spacing: float) -> Tensor:
    """Colours (N, 3) of places on the surface: the median over photos, NaN where too few show it.

    Args:
        places: (N, 3) world units.
        normals: (N, 3) unit.
        shown: the photos.
        spacing: of the points, world units.
    """
    if not shown:
        return torch.full_like(places, math.nan)
    colors = torch.stack([_colors(places, normals, one, _CLOSEST * spacing) for one in shown])
    enough = (~colors[..., 0].isnan()).sum(dim=0) >= _LEAST
    return torch.where(enough[:, None], colors.nanmedian(dim=0).values, math.nan)


def share_that_shows(
    places: Tensor, normals: Tensor, shown: Sequence[Shown], spacing: float
) -> Tensor:
    """Share (N,) of the photos which places on the surface face that show them there.

    Args:
        places: (N, 3) world units.
        normals: (N, 3) unit.
        shown: the photos.
        spacing: of the points, world units.
    """
    seen, faced = torch.zeros(len(places)), torch.zeros(len(places))
    for one in shown:
        towards = F.normalize(one.camera.center - places, dim=1)
        faced += (towards * normals).sum(dim=1) > _FACING
        seen += ~_colors(places, normals, one, _CLOSEST * spacing)[:, 0].isnan()
    return seen / faced.clamp_min(1)


def _colors(places: Tensor, normals: Tensor, shown: Shown, close: float) -> Tensor:
    """Colours (N, 3) that a photo shows at places (N, 3); NaN where it shows something else."""
    camera = shown.camera
    x, y, z = camera.project(places)
    inside = (z > 0) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    column = x.long().clamp(0, camera.width - 1)
    row = y.long().clamp(0, camera.height - 1)
    towards = F.normalize(camera.center - places, dim=1)
    facing = (towards * normals).sum(dim=1) > _FACING
    # NaN is near to nothing.
    seen = inside & facing & ((z - shown.depth[row, column]).abs() < close)
    grid = torch.stack([2 * x / camera.width - 1, 2 * y / camera.height - 1], dim=1)
    # Solid pixels alone: what lies beside the object has no say in the colour of its rim.
    solid = shown.depth.isfinite().unsqueeze(2)
    planes = torch.cat([shown.rgb * solid, solid], dim=2).permute(2, 0, 1)[None]
    found = F.grid_sample(planes, grid[None, None], align_corners=False)[0, :, 0].T
    share = found[:, 3:]
    return torch.where(seen[:, None] & (share > 0), found[:, :3] / share, math.nan)


def _look(papr: Papr, posed: PosedCloud, view: View, sums: Tensor) -> Shown:
    """Add normal, colour and 1 of every pixel to its points, by the weights of their attention."""
    camera, rgba = small(view)
    rays, shape = camera.rays().flat(), (camera.height, camera.width)
    parts = [_met(papr, posed, rays[part]) for part in torch.arange(len(rays.origins)).split(8192)]
    columns = [torch.cat(each).reshape(*shape, -1) for each in zip(*parts, strict=True)]
    alpha, surface, weights, points = columns[0][..., 0], columns[1], columns[2], columns[3]
    image = Image(rgb=rgba[..., :3], alpha=alpha, depth=camera.depth(surface), surface=surface)
    seen, shown = told(image, camera, rgba, masked=view.has_alpha)
    used = seen[..., 6] > 0
    share = weights[used].unsqueeze(-1) * seen[used].unsqueeze(1)
    sums.index_add_(0, points[used].flatten(), share.flatten(0, 1))
    return shown


def small(view: View) -> tuple[Camera, Tensor]:
    """Camera and straight colours (H, W, 4) of a view with at most 200 pixels a side."""
    largest = max(view.camera.width, view.camera.height)
    stride = math.ceil(largest / _LARGEST_SIDE)
    camera = view.camera.resized(view.camera.width // stride, view.camera.height // stride)
    return camera, _shrunk(view.rgba(), camera.height, camera.width)


def told(image: Image, camera: Camera, rgba: Tensor, *, masked: bool) -> tuple[Tensor, Shown]:
    """What the pixels of a photo say: normal, colour and 1 (H, W, 7), zeros where nothing.

    Args:
        image: what the model shows there.
        camera: of both.
        rgba: (H, W, 4) the photo.
        masked: whether the photo knows what is solid.
    """
    normal = normals(image, camera)
    # Photos without masks are transparent where they show nothing at all.
    solid = (image.alpha > _SOLID) & (rgba[..., 3] > (_SOLID if masked else 0.0))
    used = ~normal.isnan().any(dim=-1) & solid
    one = torch.ones(*solid.shape, 1)
    seen = torch.cat([normal, rgba[..., :3], one], dim=-1).where(used.unsqueeze(-1), 0.0)
    depth = image.depth.masked_fill(~solid, math.nan)
    return seen, Shown(camera=camera, rgb=rgba[..., :3], depth=depth)


def _met(papr: Papr, posed: PosedCloud, rays: RayBundle) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Opacity (R,), surface (R, 3), weights (R, k) and points (R, k) of rays (R,), on the CPU."""
    rays = rays.to(posed.positions.device)
    hits = trace(papr, posed, rays)
    surface, _ = surface_of(posed, rays, hits, papr.config.cutoff)
    return (1 - hits.background).cpu(), surface.cpu(), hits.weights.cpu(), hits.neighbours.cpu()


def _shrunk(rgba: Tensor, height: int, width: int) -> Tensor:
    """Area mean of straight colours (H, W, 4); those of pixels that are not solid do not count."""
    if rgba.shape[:2] == (height, width):
        return rgba
    return F.interpolate(rgba.permute(2, 0, 1)[None], (height, width), mode="area")[0].permute(
        1, 2, 0
    )
