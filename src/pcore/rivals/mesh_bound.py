"""Mani-GS's binding (Gao et al. 2024): Gaussians hang on triangles and follow their frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.errors import InputError
from pcore.gaussians.covariance import quaternions, rotations
from pcore.gaussians.gaussians import Gaussians

PER_TRIANGLE = 3
_ANCHOR = 10.0
"""Their factor on the lengths of a triangle ("HP") for scenes but the one of materials."""
_CORNERS = ((0.5, 0.25, 0.25), (0.25, 0.5, 0.25), (0.25, 0.25, 0.5))


@dataclass(frozen=True, kw_only=True, eq=False)
class Frames:
    """Frames of F triangles.

    Attributes:
        rotations: (F, 3, 3), columns normal, first edge, and across: `world_from_triangle`.
        origins: (F, 3) centroids, world units.
        sizes: (F, 3) factors on places, along the axes of the WORLD as their code has it, and on
            scales, along the axes of a Gaussian.
    """

    rotations: Tensor
    origins: Tensor
    sizes: Tensor


def triangle_frames(vertices: Tensor, faces: Tensor) -> Frames:
    """Frames of triangles.

    Args:
        vertices: (V, 3) world units.
        faces: (F, 3) int64.

    Raises:
        InputError: a triangle without area.
    """
    a, b, c = vertices[faces].unbind(dim=1)
    first = a - b
    normal = torch.linalg.cross(b - a, c - a)
    longest = torch.stack([(one - two).norm(dim=1) for one, two in ((a, b), (b, c), (c, a))])
    flat = normal.norm(dim=1) <= 1e-9 * longest.amax(dim=0).square()
    if bool(flat.any()):
        raise InputError(
            f"triangles: expected an area in each, got none in {int(flat.sum())} of {len(faces)}"
        )
    normal, along = F.normalize(normal, dim=1), F.normalize(first, dim=1)
    across = torch.linalg.cross(normal, along)
    length, others = longest[0], (longest[1] + longest[2]) / 2
    sizes = _ANCHOR * torch.stack([(others + length) / 2, length, others], dim=1)
    return Frames(
        rotations=torch.stack([normal, along, across], dim=2),
        origins=(a + b + c) / 3,
        sizes=sizes,
    )


def placed(local: Gaussians, frames: Frames) -> Gaussians:
    """Gaussians in the world; differentiable.

    Args:
        local: 3 F of them in the frames of their triangles, three after three.
        frames: of the triangles.
    """
    turns, origins, sizes = _repeated(frames)
    means = sizes * (turns @ local.means[..., None]).squeeze(-1) + origins
    quats = _product(quaternions(turns), local.quats)
    return replace(local, means=means, quats=quats, scales=sizes * local.scales)


def hung(world: Gaussians, frames: Frames) -> Gaussians:
    """Gaussians in the frames of their triangles: `placed` undone."""
    turns, origins, sizes = _repeated(frames)
    means = (turns.mT @ ((world.means - origins) / sizes)[..., None]).squeeze(-1)
    quats = quaternions(turns.mT @ rotations(world.quats))
    return replace(world, means=means, quats=quats, scales=world.scales / sizes)


def start_on(vertices: Tensor, faces: Tensor, *, degree: int, opacity: float) -> Gaussians:
    """Three round grey Gaussians a triangle, in its frame.

    Args:
        vertices: (V, 3) world units.
        faces: (F, 3).
        degree: of the spherical harmonics.
        opacity: of each.
    """
    frames = triangle_frames(vertices, faces)
    corners = vertices.new_tensor(_CORNERS)
    means = (corners @ vertices[faces]).reshape(-1, 3)
    area = torch.linalg.cross(*_edges(vertices, faces)).norm(dim=1) / 2
    spacing = (area / PER_TRIANGLE).sqrt().repeat_interleave(PER_TRIANGLE)
    count = len(means)
    quats = torch.zeros(count, 4)
    quats[:, 0] = 1.0
    world = Gaussians(
        means=means,
        quats=quats,
        scales=(spacing / 2)[:, None].repeat(1, 3),
        opacities=torch.full((count,), opacity),
        sh=torch.zeros(count, (degree + 1) ** 2, 3),
    )
    return hung(world, frames)


def _edges(vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    a, b, c = vertices[faces].unbind(dim=1)
    return b - a, c - a


def _repeated(frames: Frames) -> tuple[Tensor, Tensor, Tensor]:
    parts = (frames.rotations, frames.origins, frames.sizes)
    turns, origins, sizes = (one.repeat_interleave(PER_TRIANGLE, dim=0) for one in parts)
    return turns, origins, sizes


def _product(left: Tensor, right: Tensor) -> Tensor:
    """Product (N, 4) of quaternions w, x, y, z."""
    w, v = left[:, :1], left[:, 1:]
    s, u = right[:, :1], right[:, 1:]
    scalar = w * s - (v * u).sum(dim=1, keepdim=True)
    return torch.cat([scalar, w * u + s * v + torch.linalg.cross(v, u)], dim=1)
