"""True depth of meshes, by ray casting."""

from __future__ import annotations

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from torch import Tensor

from pcore.geometry.camera import Camera
from pcore.sample.sample_render import ray_caster_class

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def mesh_depth(
    vertices: FloatArray,
    faces: IntArray,
    camera: Camera,
    *,
    cut_out: NDArray[np.bool_] | None = None,
) -> Tensor:
    """Depth of a mesh by ray casting at pixel centres.

    Args:
        vertices: (V, 3) world units.
        faces: (F, 3) indices; both sides of a triangle are seen.
        camera: the view.
        cut_out: (F,) triangles with holes that the mesh does not know; None: none.

    Returns:
        (H, W) float32 camera z in world units; infinity where nothing is hit, or where a triangle
        with holes is in front, so that nobody knows.

    Raises:
        DependencyError: embreex is not installed.
    """
    rays = camera.rays().flat()
    directions = rays.directions.double().numpy()
    origin = camera.center.double().numpy()
    mesh = trimesh.Trimesh(vertices=vertices, faces=faces, process=False)
    first = ray_caster_class()(mesh).intersects_first(rays.origins.numpy(), directions)
    ray = np.flatnonzero((first >= 0) if cut_out is None else (first >= 0) & ~cut_out[first])
    # embree knows which triangle is hit; where on its plane is computed here in float64.
    corners = np.asarray(vertices, dtype=np.float64)[faces[first[ray]]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    towards = np.einsum("nd,nd->n", normal, directions[ray])
    distance = np.einsum("nd,nd->n", normal, corners[:, 0] - origin) / towards
    forward = -camera.world_from_camera[:3, 2].double().numpy()
    depth = np.full(camera.height * camera.width, np.inf, dtype=np.float32)
    depth[ray] = distance * (directions[ray] @ forward)
    return torch.from_numpy(depth.reshape(camera.height, camera.width))
