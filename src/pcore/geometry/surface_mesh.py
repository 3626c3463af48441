"""A triangle mesh with colours: the surface of an object, as other programs want it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from torch import Tensor
from torch.nn import functional as F

from pcore.errors import InputError


@dataclass(frozen=True, kw_only=True, eq=False)
class Texture:
    """Colours of a mesh as a picture.

    Attributes:
        image: (H, W, 3) in [0, 1], the first row at v = 1.
        coordinates: (V, 2) u and v in [0, 1] of the vertices, u to the right and v up.
    """

    image: Tensor
    coordinates: Tensor


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceMesh:
    """Triangles with a colour at every corner.

    Attributes:
        vertices: (V, 3) float64, world units.
        faces: (F, 3) int64 numbers of vertices, counter-clockwise from outside.
        colors: (V, 3) in [0, 1], as pictures have them (sRGB).
        texture: finer colours; None where vertices have all there is.
    """

    vertices: Tensor
    faces: Tensor
    colors: Tensor
    texture: Texture | None = None

    def __post_init__(self) -> None:
        count = len(self.vertices)
        shapes = [tuple(one.shape) for one in (self.vertices, self.faces, self.colors)]
        if shapes != [(count, 3), (len(self.faces), 3), (count, 3)]:
            raise InputError(
                "surface mesh: expected vertices (V, 3), faces (F, 3) and colours (V, 3), got "
                f"{', '.join(map(str, shapes))}"
            )

    def __len__(self) -> int:
        return len(self.faces)

    @property
    def normals(self) -> Tensor:
        """(V, 3) unit, the mean of the triangles around a vertex by area; zero without area."""
        return vertex_normals(self.vertices, self.faces)

    def moved(self, vertices: Tensor) -> SurfaceMesh:
        """Return the same triangles with their vertices (V, 3) elsewhere."""
        return replace(self, vertices=vertices)


def vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Unit normals (V, 3) of vertices (V, 3) with faces (F, 3); zero where nothing has an area."""
    first, second, third = vertices[faces].unbind(dim=1)
    across = torch.linalg.cross(second - first, third - first)
    total = torch.zeros_like(vertices)
    for corner in faces.unbind(dim=1):
        total.index_add_(0, corner, across)
    return F.normalize(total, dim=1, eps=1e-30)


def parts_of(count: int, faces: NDArray[np.int64]) -> tuple[int, NDArray[np.int64]]:
    """How many parts triangles (F, 3) of so many vertices make, and that of each vertex."""
    ends = faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    ones = np.ones(len(ends), dtype=np.bool_)
    graph = coo_array((ones, (ends[:, 0], ends[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)
