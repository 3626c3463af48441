"""A closed cage around an object, as Deforming-NeRF makes them, and the object's largest piece."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.render.distance_grid import DistanceGrid

_CELLS = 7
"""Voxels along the longest side of an object in a cage."""


def largest_piece(grid: DistanceGrid) -> tuple[Tensor, Tensor]:
    """The largest closed piece of a surface: vertices (V, 3) float32 and faces (F, 3).

    Raises:
        InputError: there is no surface.
        DependencyError: scikit-image is not installed.
    """
    import trimesh

    vertices, faces = grid.surface()
    mesh = trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=True)
    mesh.update_faces(mesh.nondegenerate_faces())
    pieces = mesh.split(only_watertight=False)
    largest = max(pieces, key=lambda one: len(one.faces)) if len(pieces) else mesh
    found = torch.from_numpy(np.array(largest.vertices)).float()
    return found, torch.from_numpy(np.array(largest.faces)).long()


def coarse_cage(grid: DistanceGrid) -> tuple[Tensor, Tensor]:
    """A closed cage around the object: vertices (V, 3) and faces (F, 3).

    As Deforming-NeRF makes them: the object in voxels, marching cubes, ten steps of smoothing by
    0.2. It is one voxel wider all around, so that nothing is left outside.

    Raises:
        InputError: nothing is inside.
        DependencyError: scikit-image is not installed.
    """
    import trimesh

    places = grid.inside()
    if not len(places):
        raise InputError("cage: expected an object inside, got none")
    low, high = places.amin(dim=0), places.amax(dim=0)
    step = float((high - low).max()) / _CELLS
    index = ((places - low) / step).floor().long()
    filled = torch.zeros(*(index.amax(dim=0) + 5).tolist())
    filled[tuple((index + 2).T)] = 1.0
    wide = torch.nn.functional.max_pool3d(filled[None], 3, stride=1, padding=1)[0]
    # Grid points are the middles of voxels; two more of them stand before the first.
    coarse = DistanceGrid(values=(1 - 2 * wide).numpy(), lower=low - 1.5 * step, voxel=step)
    vertices, faces = largest_piece(coarse)
    mesh = trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=False)
    trimesh.smoothing.filter_laplacian(mesh, lamb=0.2, iterations=10, volume_constraint=False)
    return torch.from_numpy(np.array(mesh.vertices)).float(), faces
