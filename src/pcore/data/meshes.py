"""Triangle meshes in files: PLY, OBJ and glTF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pcore.data.gltf import read_glb, read_gltf
from pcore.data.gltf_mesh import read_shape
from pcore.data.obj import parse_obj
from pcore.data.point_ply import read_point_ply
from pcore.errors import InputError
from pcore.validation import read_bytes

MESH_SUFFIXES = (".ply", ".obj", ".glb", ".gltf")
_REMEDIES = {
    ".stl": "; an STL repeats its corners in every triangle: export another of these",
}


@dataclass(frozen=True, kw_only=True)
class MeshFile:
    """What a file of a mesh holds.

    Attributes:
        vertices: (V, 3) float64 in the order of the file, world units, z up.
        faces: (F, 3) int64 vertex numbers; larger polygons are split.
    """

    vertices: Tensor
    faces: Tensor


def read_mesh(path: Path | str, *, up: Literal["y", "z"] = "z") -> MeshFile:
    """Read a mesh with its vertices in the order of the file, none merged.

    Args:
        path: a .ply, .obj, .glb or .gltf; the parts of a glTF are joined, each where its node puts
            it, with morph targets and skins as they stand in the file.
        up: the axis that points up in the file; y is turned to z as Blender's importers do,
            (x, y, z) to (x, -z, y).

    Raises:
        InputError: missing file, another suffix, damaged, compressed, no triangles, NaN or
            infinity.
    """
    path = Path(path)
    vertices, faces = _parsed(path)
    if len(faces) == 0:
        raise InputError(f"{path}: expected a mesh with faces, got {len(vertices)} bare points")
    if not np.isfinite(vertices).all():
        raise InputError(
            f"{path}: expected finite coordinates, got NaN or infinity in its vertices"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(
            f"{path}: expected faces that refer to vertices 0 to {len(vertices) - 1}, "
            f"got {faces.min()} to {faces.max()}"
        )
    if up == "y":
        vertices = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1)
    return MeshFile(vertices=torch.from_numpy(vertices), faces=torch.from_numpy(faces))


def _parsed(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and faces as they stand in the file."""
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise InputError(
            f"{path}: expected a mesh that ends in .ply, .obj, .glb or .gltf, got "
            f"{path.suffix or 'no ending'!r}{_REMEDIES.get(suffix, '')}"
        )
    content = read_bytes(path, what="a mesh (.ply, .obj, .glb, .gltf)")
    where = str(path)
    if suffix == ".glb":
        return read_shape(read_glb(content, where))
    if suffix == ".gltf":
        return read_shape(read_gltf(content, where, path.parent))
    if suffix == ".obj":
        obj = parse_obj(content, where)
        return obj.vertices, obj.faces
    points = read_point_ply(content, where)
    faces = points.triangles()
    if faces is None:
        faces = np.zeros((0, 3), dtype=np.int64)
    return points.positions().astype(np.float64), faces
