"""A mesh with fewer triangles, and with its colours in a picture."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from pcore.asset.meshing import Meshed
from pcore.errors import InputError
from pcore.geometry.surface_mesh import SurfaceMesh, Texture
from pcore.packages import package
from pcore.render.mesh_colors import surface_colors
from pcore.validation import check_count

_MOST_UNWRAPPED = 60_000
"""Triangles; unwrapping takes minutes beyond."""
_LARGEST = 8192


def require_finish(*, texture: bool, faces: bool) -> tuple[Any, Any]:
    """Return the packages that unwrap and that thin out meshes, None where not asked for.

    Raises:
        DependencyError: one is not installed; call this before long work whose end needs it.
    """
    need = "meshes with a texture or fewer triangles need"
    unwrap = package("xatlas", extra="mesh", need=need) if texture else None
    thin = package("fast_simplification", extra="mesh", need=need) if texture or faces else None
    return unwrap, thin


def check_finish(*, faces: int | None, texture: int | None) -> None:
    """Refuse numbers that no mesh can be finished with, before any work.

    Raises:
        InputError: fewer than 4 triangles, or a texture of less than 16 or more than 8192 pixels.
    """
    if faces is not None:
        check_count("--faces", faces, minimum=4)
    if texture is not None and not 16 <= texture <= _LARGEST:
        raise InputError(f"--texture: expected 16 to {_LARGEST} pixels, got {texture}")


def finished(meshed: Meshed, *, faces: int | None, texture: int | None) -> SurfaceMesh:
    """Thin a mesh out and bake its colours into a picture.

    Args:
        meshed: the mesh at rest with the pictures it was made of.
        faces: at most so many triangles; None keeps all, or 60,000 with a texture.
        texture: pixels along a side of the picture; None leaves colours at vertices.

    Raises:
        InputError: as `check_finish`.
        DependencyError: a package is not installed.
    """
    check_finish(faces=faces, texture=texture)
    unwrap, thin = require_finish(texture=texture is not None, faces=faces is not None)
    mesh = meshed.mesh
    if texture is not None and faces is None:
        faces = _MOST_UNWRAPPED
    if faces is not None and faces < len(mesh):
        mesh = _thinned(mesh, faces, meshed, thin)
    return mesh if texture is None else _textured(mesh, texture, meshed, unwrap)


def _thinned(mesh: SurfaceMesh, faces: int, meshed: Meshed, thin: Any) -> SurfaceMesh:
    """Collapse edges by quadrics until so many triangles are left."""
    # Single precision is enough of coordinates that begin at the mesh.
    middle = mesh.vertices.mean(dim=0)
    places = (mesh.vertices - middle).float().numpy()
    share = 1 - faces / len(mesh)
    vertices, corners = thin.simplify(places, mesh.faces.int().numpy(), share)
    few = torch.from_numpy(np.asarray(vertices, dtype=np.float64)) + middle
    numbers = torch.from_numpy(np.asarray(corners, dtype=np.int64))
    plain = SurfaceMesh(vertices=few, faces=numbers, colors=torch.zeros(len(few), 3))
    colors = surface_colors(few, plain.normals, meshed.views, 2 * meshed.voxel)
    return replace(plain, colors=colors)


def _textured(mesh: SurfaceMesh, side: int, meshed: Meshed, unwrap: Any) -> SurfaceMesh:
    """Unwrap a mesh and paint every pixel of the picture where it lies on the surface."""
    normals = mesh.normals
    atlas = unwrap.Atlas()
    middle = mesh.vertices.mean(dim=0)
    atlas.add_mesh((mesh.vertices - middle).float().numpy(), mesh.faces.numpy().astype(np.uint32))
    pack = unwrap.PackOptions()
    pack.resolution, pack.padding, pack.bilinear = side, 2, True
    atlas.generate(pack_options=pack)
    origin, corners, coordinates = atlas[0]
    rows = torch.from_numpy(np.asarray(origin, dtype=np.int64))
    faces = torch.from_numpy(np.asarray(corners, dtype=np.int64))
    places = torch.from_numpy(np.asarray(coordinates, dtype=np.float64))
    split = SurfaceMesh(vertices=mesh.vertices[rows], faces=faces, colors=mesh.colors[rows])
    face_of_pixel, weights = _drawn(places[faces].numpy(), side)
    where = np.argwhere(face_of_pixel >= 0)
    corner = faces[face_of_pixel[tuple(where.T)]]
    share = torch.from_numpy(weights[tuple(where.T)]).unsqueeze(-1)
    on_surface = (split.vertices[corner] * share).sum(dim=1)
    up = F.normalize((normals[rows][corner] * share).sum(dim=1), dim=1)
    colors = surface_colors(on_surface, up, meshed.views, 2 * meshed.voxel)
    image = torch.full((side, side, 3), 0.5)
    image[where[:, 0], where[:, 1]] = colors
    return replace(
        split,
        texture=Texture(image=_grown(image, face_of_pixel >= 0), coordinates=places),
    )


def _drawn(
    corners: NDArray[np.float64], side: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Which triangle (F, 3, 2) of u and v each pixel's middle is in, -1 for none, and weights."""
    face = np.full((side, side), -1, dtype=np.int64)
    weights = np.zeros((side, side, 3))
    pixels = corners * side
    pixels[..., 1] = side - pixels[..., 1]
    for number, (a, b, c) in enumerate(pixels):
        low = np.floor(np.minimum(np.minimum(a, b), c) - 0.5).astype(int).clip(0, side)
        high = np.ceil(np.maximum(np.maximum(a, b), c) + 0.5).astype(int).clip(0, side)
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0 or (high <= low).any():
            continue
        x, y = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
        first = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / area
        second = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / area
        share = np.stack([first, second, 1 - first - second], axis=-1)
        inside = (share >= 0).all(axis=-1)
        face[low[1] : high[1], low[0] : high[0]][inside] = number
        weights[low[1] : high[1], low[0] : high[0]][inside] = share[inside]
    return face, weights


def _grown(image: Tensor, known: NDArray[np.bool_]) -> Tensor:
    """Fill the picture beside its islands with the colours of their rims, for smooth look-ups."""
    from scipy.ndimage import distance_transform_edt

    index: Any = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return image[torch.from_numpy(index[0]).long(), torch.from_numpy(index[1]).long()]
