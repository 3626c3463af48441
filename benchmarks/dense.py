"""PAPR's formulas as they stand in the paper, dense: what ours is measured against.

Written from the paper, without any of our algebra or kernels: every ray looks at every point, with
tensors of rays x points x 3. The original makes them for all rays at once (28 GB for 160 x 160 rays
and 30,000 points); here they are made in chunks, of the size that was fastest on a CPU.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.kernels.reference import LENGTH_GUARD, encode, scaling
from pcore.model.papr import Papr
from pcore.render.tiles import colour

PAIRS = 2**18
"""Ray-point pairs of a chunk."""


def nearest_to_rays(
    origins: Tensor, directions: Tensor, points: Tensor, k: int, pairs: int = PAIRS
) -> Tensor:
    """Indices (R, k) of the points nearest to the lines of (R, 3) rays, nearest first."""
    rays = max(1, pairs // len(points))
    found = [
        _nearest(o, d, points, k)
        for o, d in zip(origins.split(rays), directions.split(rays), strict=True)
    ]
    return torch.cat(found)


def _nearest(origins: Tensor, directions: Tensor, points: Tensor, k: int) -> Tensor:
    to_point = points.unsqueeze(0) - origins.unsqueeze(1)
    along = (to_point * directions.unsqueeze(1)).sum(dim=-1, keepdim=True)
    off = to_point - along * directions.unsqueeze(1)
    return off.norm(dim=-1).topk(k, dim=-1, largest=False).indices


def papr_picture(
    papr: Papr, cloud: PointCloud, rays: RayBundle, *, pairs: int = PAIRS, most: int = 4096
) -> Tensor:
    """Colours (H, W, 3), at most so many rays at once; the networks are called, nothing is folded.

    Args:
        papr: an original one: rays from the camera, no cut-off.
        cloud: the points.
        rays: (H, W).
        pairs: ray-point pairs of a chunk of the search.
        most: rays whose pairs enter the networks at once.
    """
    flat, found = rays.flat(), []
    for start in range(0, len(flat.origins), most):
        found.append(attend(papr, cloud, flat[start : start + most], pairs))
    features, background = (torch.cat(parts) for parts in zip(*found, strict=True))
    return colour(papr, features.unflatten(0, rays.shape), 1 - background.unflatten(0, rays.shape))


def attend(papr: Papr, cloud: PointCloud, rays: RayBundle, pairs: int) -> tuple[Tensor, Tensor]:
    """Features (R, C) and attention of the background (R,): the paper's formulas, pair by pair."""
    config, attention = papr.config, papr.attention
    with torch.no_grad():
        near = nearest_to_rays(
            rays.origins, rays.directions, cloud.positions, config.neighbours, pairs
        )
    points, origins, d = cloud.positions[near], rays.origins, rays.directions.unsqueeze(1)
    if config.frame is not None:
        points, origins = config.frame.from_world(points), config.frame.from_world(origins)
    to_point = points - origins.unsqueeze(1)
    guarded = d / (d.square().sum(dim=-1, keepdim=True) + LENGTH_GUARD)
    along = (to_point * d).sum(dim=-1, keepdim=True) * guarded
    octaves = config.octaves
    gamma_p, gamma_h, gamma_t = (
        encode(scaling(config.coord_scale, number) * x, number)
        for x, number in (
            (points.detach(), octaves.point),
            (along, octaves.along),
            (to_point - along, octaves.across),
        )
    )
    keys = attention.w_key(attention.key(torch.cat([gamma_p, gamma_h, gamma_t], dim=-1)))
    queries = attention.query(encode(rays.directions, octaves.direction))
    queries = attention.w_query(queries).unsqueeze(-1) / math.sqrt(config.key.size)
    scores = F.relu((keys @ queries).squeeze(-1)) * cloud.influence[near]
    constant = scores.new_full((len(scores), 1), config.background_score)
    weights = torch.softmax(torch.cat([scores, constant], dim=-1), dim=-1)
    values = attention.value(torch.cat([gamma_h, gamma_t, cloud.features[near]], dim=-1))
    points_share = weights[:, :-1] / weights[:, :-1].sum(dim=-1, keepdim=True)
    return (points_share.unsqueeze(-1) * values).sum(dim=1), weights[:, -1]
