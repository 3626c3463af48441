"""Triangle meshes in files: PLY, OBJ and binary glTF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from torch import Tensor

from pcore.errors import InputError

MESH_SUFFIXES = (".ply", ".obj", ".glb")


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
        path: a .ply, .obj or .glb; the parts of a .glb are joined, each where its node puts it.
        up: the axis that points up in the file; y is turned to z as Blender's importers do,
            (x, y, z) to (x, -z, y).

    Raises:
        InputError: missing file, another suffix, damaged, no triangles, NaN or infinity.
    """
    path = Path(path)
    vertices, faces = _parsed(path)
    if faces.ndim != 2 or faces.shape[1:] != (3,) or len(faces) == 0:
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
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(
            f"{path}: expected a mesh that ends in .ply, .obj or .glb, got "
            f"{path.suffix or 'no ending'!r}"
        )
    if not path.is_file():
        raise InputError(f"{path}: no such file; expected a mesh (.ply, .obj or .glb)")
    try:
        # Materials are skipped because they would be looked up as further files.
        options: dict[str, Any] = {"process": False, "skip_materials": True}
        if path.suffix.lower() == ".obj":
            options["maintain_order"] = True
        mesh: Any = trimesh.load_scene(path, **options).to_mesh()
        vertices = np.array(mesh.vertices, dtype=np.float64)
        faces = np.array(mesh.faces, dtype=np.int64)
    except Exception as error:
        raise InputError(
            f"{path}: expected a mesh, got a file that is damaged or holds something else: {error}"
        ) from error
    return vertices, faces
