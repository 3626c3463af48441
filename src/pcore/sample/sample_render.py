"""Ray cast painted meshes: anti-aliased straight-alpha images and what cameras see of a surface."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from pcore.packages import package

Array = NDArray[Any]

_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
_SUBSAMPLES = 4  # rays along each side of a pixel


def ray_caster_class() -> Any:
    """Import trimesh's Embree ray caster; DependencyError naming the extra when it is missing."""
    caster = package(
        "trimesh.ray.ray_pyembree", extra="sample", need="casting rays needs", named="embreex"
    )
    return caster.RayMeshIntersector


class MeshCaster:
    """Finds what rays hit on a triangle mesh; needs the extra `sample` (embreex).

    Attributes:
        vertices: (V, 3) world units.
        faces: (F, 3).
    """

    def __init__(self, vertices: Array, faces: Array) -> None:
        self.vertices, self.faces = vertices, faces
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        self._embree: Any = ray_caster_class()(mesh)

    def first_hits(self, origin: Array, directions: Array) -> tuple[Array, Array, Array]:
        """Nearest hits of rays from one point.

        Args:
            origin: (3,), or (R, 3) where rays begin at different places.
            directions: (R, 3), any length.

        Returns:
            Indices (M,) of the rays that hit, their face (M,) and barycentric coordinates (M, 3).
        """
        origins = np.broadcast_to(origin, directions.shape)
        face = np.asarray(self._embree.intersects_first(origins, directions))
        ray = np.flatnonzero(face >= 0)
        corners = self.vertices[self.faces[face[ray]]] - origins[ray][:, None]
        # Areas of the three triangles that the ray and two corners span (Moeller-Trumbore).
        spans = np.cross(corners[:, [1, 2, 0]], corners[:, [2, 0, 1]])
        weights = np.einsum("mij,mj->mi", spans, directions[ray])
        weights = np.clip(weights / weights.sum(1, keepdims=True), 0.0, 1.0)
        return ray, face[ray], weights / weights.sum(1, keepdims=True)

    def blocked(self, origins: Array, target: Array) -> Array:
        """Whether anything lies between points (R, 3) and a target (3,) outside: (R,) bool."""
        return self.blocked_along(origins, target - origins)

    def blocked_along(self, origins: Array, directions: Array) -> Array:
        """Whether rays from points (R, 3) along directions (R, 3) hit anything: (R,) bool."""
        return np.asarray(self._embree.intersects_any(origins, directions))


def camera_poses(count: int, *, radius: float, highest: float, phase: float) -> Array:
    """Poses (count, 4, 4) on a golden spiral around the origin, from top to bottom.

    OpenGL camera-to-world, looking at the origin, z up.

    Args:
        count: number of cameras.
        radius: distance from the origin.
        highest: |z| / radius that the spiral stays below.
        phase: azimuth of the first camera in radians.
    """
    height = highest * (1.0 - (2.0 * np.arange(count) + 1.0) / count)
    azimuth = phase + _GOLDEN_ANGLE * np.arange(count)
    ring = np.sqrt(1.0 - height**2)
    backward = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), height], axis=1)
    right = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros(count)], axis=1)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, 0] = right
    poses[:, :3, 1] = np.cross(backward, right)
    poses[:, :3, 2] = backward
    poses[:, :3, 3] = radius * backward
    return poses


def render_rgba(
    caster: MeshCaster, colors: Array, pose: Array, *, angle_x: float, resolution: int
) -> Array:
    """Render (resolution, resolution, 4) uint8 straight alpha; every pixel is the mean of 16 rays.

    Args:
        caster: the mesh in the state to show.
        colors: (V, 3) in [0, 1], read off the surface as they are: no light is added.
        pose: (4, 4) OpenGL camera-to-world.
        angle_x: horizontal field of view in radians.
        resolution: pixels along each side.
    """
    fine = resolution * _SUBSAMPLES
    place = (np.arange(fine) + 0.5 - 0.5 * fine) * (2.0 * math.tan(0.5 * angle_x) / fine)
    x, y = np.meshgrid(place, -place)
    in_camera = np.stack([x, y, np.full_like(x, -1.0)], axis=-1).reshape(-1, 3)
    ray, face, weights = caster.first_hits(pose[:3, 3], in_camera @ pose[:3, :3].T)
    pixel = (ray // fine // _SUBSAMPLES) * resolution + (ray % fine) // _SUBSAMPLES
    color = np.einsum("mi,mic->mc", weights, colors[caster.faces[face]])
    hits = np.bincount(pixel, minlength=resolution**2)
    total = np.stack(
        [np.bincount(pixel, color[:, i], minlength=resolution**2) for i in range(3)], axis=1
    )
    rgba = np.concatenate([total / hits.clip(1)[:, None], hits[:, None] / _SUBSAMPLES**2], axis=1)
    return np.rint(255.0 * rgba).astype(np.uint8).reshape(resolution, resolution, 4)


def sample_surface(caster: MeshCaster, count: int, seed: int) -> tuple[Array, Array]:
    """Draw surface points by area: face (count,) int32, barycentric (count, 3) float32."""
    rng = np.random.default_rng(seed)
    corners = caster.vertices[caster.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.cumsum(np.linalg.norm(normal, axis=1))
    face = np.searchsorted(area, rng.random(count) * area[-1], side="right")
    root, share = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1.0 - root, root * (1.0 - share), root * share], axis=1)
    return face.astype(np.int32), weights.astype(np.float32)


def seen_samples(
    caster: MeshCaster, face: Array, weights: Array, poses: Array, *, angle_x: float
) -> Array:
    """Whether any camera sees each surface sample: (S,) bool.

    Args:
        caster: the mesh.
        face: (S,) sampled faces.
        weights: (S, 3) barycentric coordinates.
        poses: (C, 4, 4) OpenGL camera-to-world, square images.
        angle_x: field of view in radians.
    """
    corners = caster.vertices[caster.faces[face]]
    points = np.einsum("si,sic->sc", weights.astype(np.float64), corners)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-30)
    points = points + 1e-4 * normals  # off the surface, so that a ray does not meet its own face
    seen = np.zeros(len(points), dtype=bool)
    for pose in poses:
        in_camera = (points - pose[:3, 3]) @ pose[:3, :3]
        half = -in_camera[:, 2:] * math.tan(0.5 * angle_x)
        inside = (np.abs(in_camera[:, :2]) < half).all(axis=1)
        facing = ((pose[:3, 3] - points) * normals).sum(axis=1) > 0
        todo = np.flatnonzero(~seen & inside & facing)
        if len(todo):
            seen[todo] = ~caster.blocked(points[todo], pose[:3, 3])
    return seen
