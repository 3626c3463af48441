"""How the light on Gaussians changes when an edit moves them.

Light is computed for those that are pieces of the surface, and handed on to the others, by the mean
of the logarithm over neighbours that face the same way.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.neighbours import nearest
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.surfels import Surfels, known_normals
from pcore.relight.estimate import fit_light
from pcore.relight.relighting import NO_GRADIENT, Relighting
from pcore.render.surfel_fit import Observed

_MOST = 20_000
"""Pieces of surface that light is computed for, at most; evenly among all."""
_BESIDE = 16
"""Neighbours that hand their light on."""
_LIKE = 0.5
"""Least cosine between the normals of two that are lit alike."""


def lit_of(normals: Tensor) -> Tensor:
    """Indices (K,) of the Gaussians that light is computed for, given normals (N, 3)."""
    known = known_normals(normals).nonzero()[:, 0]
    if len(known) <= _MOST:
        return known
    return known[torch.linspace(0, len(known) - 1, _MOST, dtype=torch.float64).long()]


def fit_gaussian_light(observed: Observed, means: Tensor) -> Relighting:
    """Estimate the light of the photos of Gaussians.

    Args:
        observed: what photos say about N of them (`pcore.render.gaussian_surfels`).
        means: (N, 3) world units.

    Returns:
        The light on the Gaussians of `lit_of`.

    Raises:
        InputError: too few of them are pieces of a surface.
    """
    lit = lit_of(observed.normals)
    part = Observed(
        normals=observed.normals[lit],
        colors=observed.colors[lit],
        attention=observed.attention[lit],
        heights=observed.heights[lit],
    )
    return fit_light(part, means.detach().cpu().float()[lit])


@dataclass(frozen=True, kw_only=True, eq=False)
class LitPieces:
    """Pieces of surface at rest, and who hands light on to whom: the same for every pose.

    Attributes:
        lit: (K,) indices of those that light is computed for.
        surfels: of these K, where they are.
        others: (M,) indices of the rest.
        beside: (M, 16) rows of `lit` that lie nearest to each of them; fewer columns of few.
        alike: (M, 16) whether these hand their light on.
    """

    lit: Tensor
    surfels: Surfels
    others: Tensor
    beside: Tensor
    alike: Tensor

    @classmethod
    def of(cls, surfels: Surfels) -> LitPieces:
        """Divide N pieces of surface at rest."""
        lit, places, normals = lit_of(surfels.normals), surfels.places, surfels.normals
        unlit = torch.ones(len(surfels), dtype=torch.bool)
        unlit[lit] = False
        others = unlit.nonzero()[:, 0] if len(lit) else lit
        beside = lit.new_zeros(0, min(_BESIDE, len(lit)))
        if len(others):
            beside, _ = nearest(places[lit], places[others], min(_BESIDE, len(lit)))
        facing = normals[others].unsqueeze(1)
        alike = (normals[lit][beside] * facing).sum(dim=-1) > _LIKE
        alike |= ~known_normals(normals[others]).unsqueeze(1)
        # Where no neighbour faces the same way, all of them count.
        alike |= ~alike.any(dim=1, keepdim=True)
        own = Surfels.at_rest(places[lit], normals[lit], torch.zeros(len(lit)))
        return cls(lit=lit, surfels=own, others=others, beside=beside, alike=alike)


def gaussian_gains(
    relighting: Relighting,
    pieces: LitPieces,
    positions: Tensor,
    local_maps: LocalMaps,
    *,
    world: float = 1.0,
) -> Tensor:
    """Find by which factor the light on Gaussians has changed, while it stands still.

    Args:
        relighting: from `fit_gaussian_light`.
        pieces: of all N.
        positions: (N, 3) where the means are now, finite, world units.
        local_maps: how space moved around them.
        world: factor by which the lamps are scaled about the origin meanwhile.

    Returns:
        Bounded factors (N,) on the brightness that photos stored, float32 on the CPU.

    Raises:
        InputError: as `Relighting.gains`.
    """
    followed = positions.requires_grad or local_maps.to_rest.requires_grad
    if torch.is_grad_enabled() and followed:
        raise InputError(NO_GRADIENT)
    with torch.no_grad():
        return _gains(relighting, pieces, positions, local_maps, world)


def _gains(
    relighting: Relighting,
    pieces: LitPieces,
    positions: Tensor,
    local_maps: LocalMaps,
    world: float,
) -> Tensor:
    lit, rest = pieces.lit, pieces.surfels.places
    moved = positions.detach().cpu().float()[lit]
    maps = LocalMaps(to_rest=local_maps.to_rest.detach().cpu().float()[lit])
    cloud = PointCloud(
        positions=rest, features=rest.new_zeros(len(lit), 0), influence=rest.new_zeros(len(lit))
    )
    posed = PosedCloud(
        cloud=cloud, positions=moved, local_maps=maps, surfels=pieces.surfels.moved(moved, maps)
    )
    gains = torch.ones(len(positions))
    gains[lit] = relighting.gains(posed, world=world)
    if len(pieces.others):
        logs = gains[lit].log()[pieces.beside] * pieces.alike
        gains[pieces.others] = (logs.sum(dim=1) / pieces.alike.sum(dim=1)).exp()
    return gains
