"""Surface consistency under a deformation: D(surface(P)) = surface(D(P)) (paper, "Method")."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pcore.deform.base import Deformation
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.render.image import Image


@dataclass(frozen=True, kw_only=True)
class Canonical:
    """What the canonical state says about a patch; all without gradient.

    R is the shape of the rays: (H, W), or (H, W, S) with S per pixel.

    Attributes:
        surface: (*R, 3) surface points s.
        foreground: (*R) whether the ray's pixel shows the object.
        ends: (*R, 3) where on each ray it ends: beside s for the foreground, beside the nearest
            point for the background.
        rgb: (H, W, 3) the rendering, or the photo, that the deformed rendering should repeat.
    """

    surface: Tensor
    foreground: Tensor
    ends: Tensor
    rgb: Tensor


def canonical_of(
    image: Image, cloud: PointCloud, rays: RayBundle, rgb: Tensor, foreground_alpha: float
) -> Canonical:
    """Stop the gradient (sg of the paper) and find where every ray ends.

    The end is the projection of the surface point ON the ray: aiming at the surface point itself,
    which lies up to a point spacing beside the ray, would shift the picture and blur it.
    """
    surface = image.ray_hits.centroid.detach().reshape(*rays.shape, 3)
    foreground = image.alpha.detach() > foreground_alpha
    if rays.samples is not None:
        foreground = foreground.unsqueeze(-1).expand(rays.shape)
    nearest = cloud.positions.detach()[image.ray_hits.neighbours[:, 0]].view_as(surface)
    target = torch.where(foreground.unsqueeze(-1), surface, nearest)
    along = ((target - rays.origins) * rays.directions).sum(dim=-1, keepdim=True)
    return Canonical(
        surface=surface,
        foreground=foreground,
        ends=rays.origins + along * rays.directions,
        rgb=rgb.detach(),
    )


def points_only_rays(rays: RayBundle, canonical: Canonical, deformation: Deformation) -> RayBundle:
    """Rays from the original origins to the deformed ends (paper, "Points-only mode")."""
    return _towards(rays, rays.origins, deformation(canonical.ends))


def rays_and_points_rays(
    rays: RayBundle,
    canonical: Canonical,
    deformation: Deformation,
    origin_distance: float,
    *,
    keep_distance: bool = False,
) -> RayBundle:
    """Rays from deformed origins near the surface to the deformed ends ("Rays-and-points mode").

    Args:
        rays: (H, W) or (H, W, S) canonical rays.
        canonical: where they end.
        deformation: the field D.
        origin_distance: how far before the end the origin is put, as a fraction of the distance
            between camera and end.
        keep_distance: then slide the deformed origin along its ray until it is as far from the end
            as the camera was. The line stays the same; the network sees distances it knows.
    """
    origins = canonical.ends + origin_distance * (rays.origins - canonical.ends)
    ends = deformation(canonical.ends)
    moved = _towards(rays, deformation(origins), ends)
    if not keep_distance:
        return moved
    distance = (rays.origins - canonical.ends).norm(dim=-1, keepdim=True)
    return replace(moved, origins=ends - distance * moved.directions)


def _towards(rays: RayBundle, origins: Tensor, ends: Tensor) -> RayBundle:
    """Rays like others, from origins (*R, 3) to ends (*R, 3)."""
    difference = ends - origins
    return replace(
        rays,
        origins=origins,
        directions=difference / difference.norm(dim=-1, keepdim=True).clamp_min(1e-12),
    )


@dataclass(frozen=True, kw_only=True)
class Consistency:
    """L_geo and L_tex of one mode.

    Attributes:
        geometry: mean squared distance over the foreground (Eq. geo), in squared `unit`s.
        texture: mean squared difference of colours.
    """

    geometry: Tensor
    texture: Tensor


def consistency(
    image: Image,
    canonical: Canonical,
    target: Tensor,
    *,
    unit: float,
    background_rays: bool,
) -> Consistency:
    """Compare the deformed rendering with what the deformation makes of the canonical one.

    Args:
        image: of the deformed cloud D(P) along deformed rays.
        canonical: what the canonical state says.
        target: (*R, 3) where the deformation takes the canonical surface points.
        unit: length in which L_geo is measured, world units.
        background_rays: whether rays of the background enter L_tex.

    Returns:
        Both losses; zero where the patch has no foreground.
    """
    foreground = canonical.foreground
    hits = image.ray_hits
    offset = hits.centroid.view_as(target) - target
    # Rays that left the cut-off have no surface point; L_tex sees them as holes.
    met = foreground & hits.mask.view_as(foreground)
    geometry = (offset / unit).square().sum(dim=-1)[met].sum() / foreground.sum().clamp_min(1)
    difference = (image.rgb - canonical.rgb).square().mean(dim=-1)
    pixels = foreground if foreground.shape == difference.shape else foreground[..., 0]
    chosen = torch.ones_like(pixels) if background_rays else pixels
    texture = (difference * chosen).sum() / difference.numel()
    return Consistency(geometry=geometry, texture=texture)
