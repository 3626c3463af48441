"""The surface over a cloud's points: a small plane over each.

Points have no extent and lie a little inside the object. What a ray meets is the surface over them:
that is where it is deep, where light falls on it, and where both change at an edge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.errors import InputError
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.neighbours import nearest
from pcore.geometry.tensors import Tensors
from pcore.geometry.visibility import cloud_spacing

_BESIDE = 16
"""Pieces of surface around a point from which a ray chooses (ADR 14)."""
_UNIT = 1e-3
_KNOWN = 0.25


@dataclass(frozen=True, kw_only=True, repr=False)
class Surfels(Tensors):
    """Small pieces of surface, one over each of N points.

    A model knows normals and heights at rest; the rest follows from where the points are.

    Attributes:
        places: (N, 3) world units.
        normals: (N, 3) unit, outwards; zero where none is known.
        heights: (N,) how far above their points the pieces lie at rest, along the normals there,
            world units.
        beside: (N, K) int64, for every point the pieces with a normal that were nearest at rest;
            K is 0 where no normal is known.
        spacing: how far the points are apart, world units; a tensor () where autograd follows it.
    """

    places: Tensor
    normals: Tensor
    heights: Tensor
    beside: Tensor
    spacing: float | Tensor

    def __post_init__(self) -> None:
        parts = (self.places, self.normals, self.heights, self.beside)
        shapes = [tuple(one.shape) for one in parts]
        count = shapes[0][:1]
        expected = [(*count, 3), (*count, 3), count, (*count, *shapes[3][1:])]
        if shapes != expected or len(shapes[3]) != 2:
            raise InputError(
                "surfels: expected places (N, 3), normals (N, 3), heights (N,) and neighbours "
                f"(N, K), got {', '.join(map(str, shapes))}"
            )

    @classmethod
    def at_rest(cls, positions: Tensor, normals: Tensor, heights: Tensor) -> Surfels:
        """Put pieces over canonical points.

        Args:
            positions: (N, 3) world units.
            normals: (N, 3) unit; zero where none is known.
            heights: (N,) world units.

        Raises:
            InputError: other shapes, normals of another length, heights that are not finite.
        """
        if not bool(((normals == 0).all(dim=-1) | of_unit_length(normals)).all()):
            raise InputError("surfels: expected normals of unit length, or zero where not known")
        if not bool(heights.isfinite().all()):
            raise InputError("surfels: expected finite heights, got NaN or infinity")
        positions = positions.detach()
        return cls(
            places=positions + heights.unsqueeze(-1) * normals,
            normals=normals,
            heights=heights,
            beside=_beside(positions, known_normals(normals)).to(positions.device),
            spacing=spacing_of(positions),
        )

    def __len__(self) -> int:
        return len(self.places)

    @property
    def known(self) -> Tensor:
        """(N,) bool, which pieces have a normal."""
        return known_normals(self.normals)

    def over(self, positions: Tensor) -> Surfels:
        """Return these pieces at rest over canonical points (N, 3) that autograd may follow."""
        normals = self.normals.to(positions)
        lifted = self.heights.to(positions).unsqueeze(-1) * normals
        return replace(self, places=positions + lifted, normals=normals)

    def moved(self, positions: Tensor, local_maps: LocalMaps) -> Surfels:
        """Return these pieces at rest as they lie over posed points (N, 3), world units.

        A normal turns by the transposed inverse of the local map. Where a map folds space or has no
        inverse, the piece is where the point is and has no normal any more.
        """
        to_rest = local_maps.to_rest.to(positions)
        upright = determinants(to_rest.detach()) > 0
        if not bool(upright.all()):
            unit = torch.eye(3, dtype=to_rest.dtype, device=to_rest.device)
            to_rest = torch.where(upright[:, None, None], to_rest, unit)
            local_maps = LocalMaps(to_rest=to_rest)
        normals = self.normals.to(positions)
        lifted = torch.linalg.solve(to_rest, self.heights.to(positions).unsqueeze(-1) * normals)
        turned = F.normalize(torch.einsum("nji,nj->ni", to_rest, normals), dim=1)
        whole = upright & lifted.isfinite().all(dim=1)
        return replace(
            self,
            places=positions + torch.where(whole.unsqueeze(1), lifted, 0.0),
            normals=torch.where(whole.unsqueeze(1), turned, 0.0),
            beside=self.beside.to(positions.device),
            spacing=self.spacing * local_maps.followed_growth,
        )


def determinants(matrices: Tensor) -> Tensor:
    """(N,) of matrices (N, 3, 3), in closed form: torch.linalg.det factorises one by one."""
    first, second, third = matrices.unbind(dim=-2)
    return (first * torch.linalg.cross(second, third)).sum(dim=-1)


def of_unit_length(vectors: Tensor) -> Tensor:
    """(N,) bool, which vectors (N, 3) have a length of 1, nearly."""
    return (vectors.norm(dim=-1) - 1).abs() < _UNIT


def known_normals(normals: Tensor) -> Tensor:
    """(N,) bool, which normals (N, 3) are known: of unit length, not zero."""
    return normals.square().sum(dim=-1) > _KNOWN


def spacing_of(points: Tensor) -> float:
    """How far points (N, 3) lie apart, world units; 0 for one alone."""
    return cloud_spacing(points) if len(points) > 1 else 0.0


def _beside(positions: Tensor, known: Tensor) -> Tensor:
    """Indices (N, 16) of the points with a normal that are nearest at rest; (N, 0) if none."""
    rows = known.nonzero()[:, 0].cpu()
    if len(rows) == 0:
        return torch.zeros(len(positions), 0, dtype=torch.int64)
    positions = positions.cpu()
    return rows[nearest(positions[rows], positions, _BESIDE)[0]]
