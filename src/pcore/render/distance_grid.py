"""Distances from a surface on a grid, and the surface where they are zero."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pcore.errors import InputError
from pcore.packages import package

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class DistanceGrid:
    """Signed distances at the centres of voxels.

    Attributes:
        values: (X, Y, Z) in any unit, positive outside.
        shown: (X, Y, Z) where a surface may be; None: everywhere.
        lower: (3,) float64 centre of the first voxel, world units.
        voxel: between centres, world units.
    """

    values: NDArray[np.float32]
    shown: BoolArray | None = None
    lower: Tensor
    voxel: float

    def inside(self) -> Tensor:
        """(P, 3) centres of the voxels inside, world units."""
        return self.lower + self.voxel * torch.from_numpy(np.argwhere(self.values < 0))

    def surface(self) -> tuple[Tensor, Tensor]:
        """Vertices (V, 3) float64 and faces (F, 3) int64, counter-clockwise from outside.

        Raises:
            InputError: nothing is inside.
            DependencyError: scikit-image is not installed.
        """
        marching_cubes = require_marching_cubes()
        # A rim of empty space: nothing ends at the box.
        padded = np.pad(self.values, 1, constant_values=1.0)
        if not (padded.min() < 0 < padded.max()):
            raise InputError("mesh: expected a surface in the box, got nothing that is solid")
        vertices, faces, _, _ = marching_cubes(padded, 0.0, gradient_direction="descent")
        vertices = vertices.astype(np.float64) - 1.0
        if self.shown is not None:
            faces = faces[_on_seen(vertices, self.shown)[faces].all(axis=1)]
        a, b, c = faces.T
        faces = faces[(a != b) & (b != c) & (a != c)].astype(np.int64)
        used, numbers = torch.unique(torch.from_numpy(faces), return_inverse=True)
        return self.lower + self.voxel * torch.from_numpy(vertices)[used], numbers


def require_marching_cubes() -> Any:
    """Return scikit-image's marching cubes.

    Raises:
        DependencyError: it is not installed; call this before long work whose end is a mesh.
    """
    skimage = package(
        "skimage.measure", extra="mesh", need="making meshes needs", named="scikit-image"
    )
    return skimage.marching_cubes


def _on_seen(vertices: NDArray[np.float64], seen: BoolArray) -> BoolArray:
    """Which vertices (V, 3), in voxels, lie on an edge of the grid whose ends are both seen."""
    most = np.array(seen.shape) - 1
    low = np.clip(np.floor(vertices).astype(int), 0, most)
    high = np.clip(np.ceil(vertices).astype(int), 0, most)
    return seen[tuple(low.T)] & seen[tuple(high.T)]
