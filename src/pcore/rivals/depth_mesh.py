"""A mesh of what a trained object shows: depth of its training views, fused (Curless, Levoy)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pcore.errors import DependencyError, InputError
from pcore.geometry.camera import Camera
from pcore.render.image import Image

_VIEWS = 40
"""More add nothing at these sizes."""
_REACH = 4.0
"""How many voxels before and behind a surface distances are trusted."""
_SOLID = 0.5
_MARGIN = 0.06
"""Share of the object's extent around it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fused:
    """Signed distances on a grid.

    Attributes:
        values: (X, Y, Z) in voxels, positive outside; places that no view sees are inside.
        lower: (3,) the first grid point, world units.
        step: between grid points, world units.
    """

    values: Tensor
    lower: Tensor
    step: float


def fuse(
    draw: Callable[[Camera], Image],
    cameras: Sequence[Camera],
    lower: Tensor,
    upper: Tensor,
    *,
    cells: int,
) -> Fused:
    """Fuse the depth of pictures.

    Args:
        draw: takes a picture of the object at rest.
        cameras: of the training views; evenly chosen ones are used.
        lower: (3,) corner of the object's box, world units.
        upper: (3,) corner of it.
        cells: along its longest side.
    """
    margin = _MARGIN * (upper - lower).max()
    lower, upper = lower - margin, upper + margin
    step = float((upper - lower).max()) / cells
    counts = ((upper - lower) / step).ceil().long() + 1
    axes = [lower[i] + step * torch.arange(int(counts[i])) for i in range(3)]
    points = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1).reshape(-1, 3)
    total, weight = torch.zeros(len(points)), torch.zeros(len(points))
    chosen = [
        cameras[i] for i in np.linspace(0, len(cameras) - 1, min(_VIEWS, len(cameras))).astype(int)
    ]
    for camera in chosen:
        seen, distance = _distances(draw(camera), camera, points, step)
        total[seen] += distance
        weight[seen] += 1
    values = torch.where(weight > 0, total / weight.clamp_min(1), -1.0)
    return Fused(values=values.reshape(*counts.tolist()), lower=lower, step=step)


def _distances(
    picture: Image, camera: Camera, points: Tensor, step: float
) -> tuple[Tensor, Tensor]:
    """Which points a picture tells about, and their distances in (-1, 1) times the reach."""
    across, down, depth = camera.project(points)
    column, row = across.floor().long(), down.floor().long()
    inside = (depth > 0) & (column >= 0) & (column < camera.width)
    inside &= (row >= 0) & (row < camera.height)
    column, row = column.clamp(0, camera.width - 1), row.clamp(0, camera.height - 1)
    surface = picture.depth[row, column]
    # Where nothing is drawn a view sees through to infinity.
    free = (picture.alpha[row, column] < _SOLID) | surface.isnan()
    ahead = torch.where(free, torch.inf, surface - depth) / (_REACH * step)
    seen = (inside & (ahead > -1)).nonzero().squeeze(-1)
    return seen, ahead[seen].clamp(-1, 1)


def mesh_of(fused: Fused) -> tuple[Tensor, Tensor]:
    """The largest closed piece of the surface: vertices (V, 3) and faces (F, 3), turned outwards.

    Raises:
        InputError: there is no surface.
        DependencyError: scikit-image is not installed.
    """
    try:
        from skimage.measure import marching_cubes
    except ImportError as error:
        raise DependencyError(
            "meshes of depth need scikit-image, which is not installed: pip install "
            "'pcore-edit[metrics]'"
        ) from error
    import trimesh

    # Outside of the grid nothing is.
    padded = np.pad(fused.values.numpy(), 1, constant_values=1.0)
    if not (padded.min() < 0 < padded.max()):
        raise InputError("mesh of depth: expected a surface, got none in any picture")
    vertices, faces, _, _ = marching_cubes(padded, 0.0, gradient_direction="ascent")
    mesh = trimesh.Trimesh(vertices, faces, process=True)
    mesh.update_faces(mesh.nondegenerate_faces())
    pieces = mesh.split(only_watertight=False)
    largest = max(pieces, key=lambda one: len(one.faces)) if len(pieces) else mesh
    if largest.volume < 0:
        largest.invert()
    places = torch.from_numpy(np.array(largest.vertices)).float()
    placed = fused.lower + fused.step * (places - 1)
    return placed, torch.from_numpy(np.array(largest.faces)).long()


def coarse_cage(fused: Fused, *, cells: int = 7) -> tuple[Tensor, Tensor]:
    """A closed cage around the object: vertices (V, 3) and faces (F, 3).

    As Deforming-NeRF makes them: the object in voxels, marching cubes, ten steps of smoothing by
    0.2. It is one voxel wider all around, so that nothing is left outside.

    Args:
        fused: the object.
        cells: voxels along its longest side.

    Raises:
        InputError: nothing is inside.
        DependencyError: scikit-image is not installed.
    """
    import trimesh

    inside = (fused.values < 0).nonzero()
    if not len(inside):
        raise InputError("cage: expected an object inside, got none")
    places = fused.lower + fused.step * inside
    low, high = places.amin(dim=0), places.amax(dim=0)
    step = float((high - low).max()) / cells
    index = ((places - low) / step).floor().long()
    grid = torch.zeros(*(index.amax(dim=0) + 5).tolist())
    grid[tuple((index + 2).T)] = 1.0
    wide = torch.nn.functional.max_pool3d(grid[None], 3, stride=1, padding=1)[0]
    # Grid points are the middles of voxels; two more of them stand before the first.
    vertices, faces = mesh_of(Fused(values=1 - 2 * wide, lower=low - 1.5 * step, step=step))
    mesh = trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=False)
    trimesh.smoothing.filter_laplacian(mesh, lamb=0.2, iterations=10, volume_constraint=False)
    return torch.from_numpy(np.array(mesh.vertices)).float(), faces
