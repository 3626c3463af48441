"""True pictures: ray cast, textured, lit by lamps that cast shadows; depth and normals beside.

Every pixel is the mean of 16 rays; depth and normal are those of the ray through its centre. Light
is a sky that is brighter above and two soft lamps. It shines on the shape that is drawn (`fixed`),
or on the canonical shape, so that brightness sticks to the surface (`baked`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcore.benchmark.look import FloatArray, Look, corner_normals, display, mesh_normals
from pcore.sample.sample_render import MeshCaster

_SUBSAMPLES = 4
_LAYERS = 8
"""Cut-out surfaces that a ray passes at most."""
_OFF = 2e-4
"""How far over the surface shadow rays begin, in units of an object of radius 1."""
SKY, GROUND = 0.42, 0.18
"""Brightness from straight above and from below."""
LAMPS = (
    ((0.5, -0.6, 0.75), 0.5, 0.10),
    ((-0.8, 0.1, 0.35), 0.15, 0.18),
)
"""Direction, brightness and radius of the lamps, each as seen from the object."""
_FAR = 50.0
_MOST_RAYS = 2**20
"""That are cast at a time: all of a large picture would take gigabytes in every thread."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shape:
    """A state of a mesh that rays can be cast at.

    Attributes:
        caster: finds what rays hit.
        normals: (F, 3) of the faces.
        corners: (F, 3, 3) normals at their corners, for shading.
    """

    caster: MeshCaster
    normals: FloatArray
    corners: FloatArray

    @classmethod
    def of(cls, vertices: FloatArray, faces: NDArray[np.int64], look: Look) -> Shape:
        """Make one of vertices (V, 3) and faces (F, 3)."""
        return cls(
            caster=MeshCaster(vertices, faces),
            normals=mesh_normals(vertices, faces),
            corners=corner_normals(vertices, faces, look.smooth),
        )

    def normals_at(self, face: NDArray[np.int64], weights: FloatArray) -> FloatArray:
        """Shading normals (M, 3) at barycentric coordinates (M, 3) of faces (M,)."""
        mixed = np.einsum("mi,mic->mc", weights, self.corners[face])
        return mixed / np.linalg.norm(mixed, axis=1, keepdims=True).clip(1e-12)


@dataclass(frozen=True, kw_only=True, eq=False)
class Shot:
    """A true picture.

    Attributes:
        rgba: (H, W, 4) uint8, sRGB, straight alpha.
        depth: (H, W) float32 camera z of what the centre of a pixel shows; infinite for nothing.
        normal: (H, W, 3) float32 of the surface there, world frame, towards the camera; zero for
            nothing.
    """

    rgba: NDArray[np.uint8]
    depth: NDArray[np.float32]
    normal: NDArray[np.float32]


def take(
    shape: Shape, look: Look, lit: Shape, pose: FloatArray, *, angle_x: float, resolution: int
) -> Shot:
    """Take a picture.

    Args:
        shape: what is there.
        look: what is painted on it.
        lit: the same mesh as the light finds it: `shape`, or the canonical one.
        pose: (4, 4) OpenGL camera-to-world.
        angle_x: horizontal field of view in radians.
        resolution: pixels along each side.
    """
    fine = resolution * _SUBSAMPLES
    count, total = np.zeros(resolution**2), np.zeros((3, resolution**2))
    for ray, directions in _rays(shape, pose, angle_x, fine):
        hit, face, weights, paint = _cast(shape, look, pose[:3, 3], directions)
        light = light_on(lit, look, face, weights, facing=_facing(shape, face, directions[hit]))
        color = display(paint[:, :3] * light[:, None])
        pixel = (ray[hit] // fine // _SUBSAMPLES) * resolution + (ray[hit] % fine) // _SUBSAMPLES
        count += np.bincount(pixel, minlength=resolution**2)
        total += [np.bincount(pixel, color[:, k], minlength=resolution**2) for k in range(3)]
    rgba = np.stack([*(one / count.clip(1) for one in total), count / _SUBSAMPLES**2], axis=1)
    depth, normal = geometry_of(shape, look, pose, angle_x, resolution)
    return Shot(
        rgba=np.rint(255.0 * rgba).astype(np.uint8).reshape(resolution, resolution, 4),
        depth=depth,
        normal=normal,
    )


def _rays(
    shape: Shape, pose: FloatArray, angle_x: float, size: int
) -> Iterator[tuple[NDArray[np.int64], FloatArray]]:
    """Numbers (R,) of the pixels of a square that may show the mesh, and their rays (R, 3).

    They come in bands of whole rows, `_MOST_RAYS` at a time.
    """
    step = 2.0 * math.tan(0.5 * angle_x) / size
    local = (shape.caster.vertices - pose[:3, 3]) @ pose[:3, :3]
    before = local[local[:, 2] < -1e-6]
    if len(before) < len(local):
        columns = rows = (0, size)
    else:
        across, down = local[:, 0] / -local[:, 2], local[:, 1] / local[:, 2]
        columns, rows = _span(across, step, size), _span(down, step, size)
    height = max(1, _MOST_RAYS // max(1, columns[1] - columns[0]))
    for top in range(*rows, height):
        band = slice(top, min(top + height, rows[1]))
        row, column = np.mgrid[band, columns[0] : columns[1]].reshape(2, -1)
        x = (column + 0.5 - 0.5 * size) * step
        y = -(row + 0.5 - 0.5 * size) * step
        in_camera = np.stack([x, y, np.full_like(x, -1.0)], axis=1)
        yield row * size + column, in_camera @ pose[:3, :3].T


def _span(places: FloatArray, step: float, size: int) -> tuple[int, int]:
    """First and last (exclusive) pixel along an axis that places on the image plane cover."""
    first = math.floor(places.min() / step + 0.5 * size) - 1
    last = math.ceil(places.max() / step + 0.5 * size) + 1
    return min(max(first, 0), size), min(max(last, 0), size)


def _cast(
    shape: Shape, look: Look, origin: FloatArray, directions: FloatArray
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray, FloatArray]:
    """Rays that hit (M,), their face (M,), barycentric coordinates (M, 3) and paint (M, 4)."""
    hit, face, weights = shape.caster.first_hits(origin, directions)
    paint = look.rgba(shape.caster.faces, face, weights)
    if not look.has_holes:
        return hit, face, weights, paint
    passing = look.passes(face, paint[:, 3])
    kept = [(hit[~passing], face[~passing], weights[~passing], paint[~passing])]
    waiting, at = hit[passing], _places(shape, face[passing], weights[passing])
    for _ in range(_LAYERS):
        if len(waiting) == 0:
            break
        along = directions[waiting] / np.linalg.norm(directions[waiting], axis=1, keepdims=True)
        start = at + _OFF * along
        rows, face, weights = shape.caster.first_hits(start, along)
        paint = look.rgba(shape.caster.faces, face, weights)
        passing = look.passes(face, paint[:, 3])
        kept.append((waiting[rows][~passing], face[~passing], weights[~passing], paint[~passing]))
        waiting = waiting[rows][passing]
        at = _places(shape, face[passing], weights[passing])
    hits, faces, shares, paints = (np.concatenate(parts) for parts in zip(*kept, strict=True))
    return hits, faces, shares, paints


def _places(shape: Shape, face: NDArray[np.int64], weights: FloatArray) -> FloatArray:
    corners = shape.caster.vertices[shape.caster.faces[face]]
    return np.einsum("mi,mic->mc", weights, corners)


def _facing(shape: Shape, face: NDArray[np.int64], directions: FloatArray) -> FloatArray:
    """1 where a ray meets the front of a face (M,), -1 where its back."""
    return np.where(np.einsum("mc,mc->m", shape.normals[face], directions) > 0, -1.0, 1.0)


def light_on(
    lit: Shape, look: Look, face: NDArray[np.int64], weights: FloatArray, *, facing: FloatArray
) -> FloatArray:
    """Brightness (M,) of the side of the surface that is seen; what is cut out throws no shadow."""
    normal = lit.normals_at(face, weights) * facing[:, None]
    # Over the face itself: a shading normal may lean so far that the face would shade itself.
    place = _places(lit, face, weights) + _OFF * lit.normals[face] * facing[:, None]
    brightness = GROUND + (SKY - GROUND) * 0.5 * (1.0 + normal[:, 2])
    random = np.random.default_rng(0)
    for direction, strength, radius in LAMPS:
        towards = np.array(direction) / np.linalg.norm(direction)
        # Every ray asks for another place of the lamp: the mean of a pixel's rays is a soft shadow.
        spread = random.normal(size=(len(face), 3)) * radius
        ways = towards + spread - (spread @ towards)[:, None] * towards
        cosine = np.einsum("mc,mc->m", normal, ways) / np.linalg.norm(ways, axis=1)
        turned = np.flatnonzero(cosine > 0)
        if len(turned):
            free = np.ones(len(turned), dtype=bool)
            free[_blocked(lit, look, place[turned], ways[turned])] = False
            brightness[turned] += strength * cosine[turned] * free
    return brightness


def _blocked(
    shape: Shape, look: Look, places: FloatArray, ways: FloatArray
) -> NDArray[np.bool_] | NDArray[np.int64]:
    """Which rays from places (M, 3) along ways (M, 3) hit anything: a mask, or their numbers."""
    if not look.has_holes:
        return shape.caster.blocked_along(places, ways)
    return _cast(shape, look, places, ways)[0]


def geometry_of(
    shape: Shape, look: Look, pose: FloatArray, angle_x: float, resolution: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Depth (H, W) and normals (H, W, 3) of a `Shot`; arguments are those of `take`."""
    depth = np.full(resolution**2, np.inf, dtype=np.float32)
    normal = np.zeros((resolution**2, 3), dtype=np.float32)
    for ray, directions in _rays(shape, pose, angle_x, resolution):
        hit, face, weights, _ = _cast(shape, look, pose[:3, 3], directions)
        places = _places(shape, face, weights) - pose[:3, 3]
        depth[ray[hit]] = -(places @ pose[:3, 2])
        facing = _facing(shape, face, directions[hit])[:, None]
        normal[ray[hit]] = shape.normals_at(face, weights) * facing
    return depth.reshape(resolution, resolution), normal.reshape(resolution, resolution, 3)
