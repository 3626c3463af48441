"""The paint of a model: colours, textures and cut-outs at places of its surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_CUTS = 8
"""Parts of the sides of a face at whose ends it is looked for what is cut out."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Texture:
    """A picture on a surface.

    Attributes:
        pixels: (H, W, 4) uint8, sRGB and straight alpha; row 0 is v = 0, as in glTF.
        wrap: what u and v do beyond 0 to 1: repeat, mirror or stay.
        uv_set: which texture coordinates of the vertices it takes.
        offset: of u, v (KHR_texture_transform).
        scale: of u, v.
        rotation: of u, v, radians.
    """

    pixels: NDArray[np.uint8]
    wrap: tuple[str, str] = ("repeat", "repeat")
    uv_set: int = 0
    offset: tuple[float, float] = (0.0, 0.0)
    scale: tuple[float, float] = (1.0, 1.0)
    rotation: float = 0.0

    def moved(self, uv: FloatArray) -> FloatArray:
        """Places in the picture (M, 2), v downwards, of texture coordinates (M, 2)."""
        cosine, sine = np.cos(self.rotation), np.sin(self.rotation)
        scaled = uv * self.scale
        # KHR_texture_transform turns counter-clockwise in a frame whose v points down.
        turned = np.stack(
            [
                cosine * scaled[:, 0] + sine * scaled[:, 1],
                -sine * scaled[:, 0] + cosine * scaled[:, 1],
            ],
            axis=1,
        )
        return turned + self.offset

    def at(self, uv: FloatArray) -> FloatArray:
        """Linear RGBA (M, 4) at texture coordinates (M, 2), bilinear."""
        place = self.moved(uv)
        height, width = self.pixels.shape[:2]
        x, y = place[:, 0] * width - 0.5, place[:, 1] * height - 0.5
        left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        across, down = (x - left)[:, None], (y - top)[:, None]
        columns = [_wrapped(left + k, width, self.wrap[0]) for k in (0, 1)]
        rows = [_wrapped(top + k, height, self.wrap[1]) for k in (0, 1)]
        corners = [[linear_rgba(self.pixels[row, column]) for column in columns] for row in rows]
        upper = corners[0][0] * (1 - across) + corners[0][1] * across
        lower = corners[1][0] * (1 - across) + corners[1][1] * across
        return upper * (1 - down) + lower * down


@dataclass(frozen=True, kw_only=True, eq=False)
class Material:
    """How a part of the surface looks.

    Attributes:
        color: linear RGBA factor.
        texture: multiplied with it; None for none.
        cutoff: alpha under which a ray passes; 0 for opaque surfaces, whose alpha is ignored.
        emits: it shines by itself, which is left out.
    """

    color: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)
    texture: Texture | None = None
    cutoff: float = 0.0
    emits: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """What is painted on a mesh; it does not move when the mesh does.

    Attributes:
        materials: of all parts.
        material_of_face: (F,) which one a face has.
        uv: texture coordinates (V, 2) by set.
        colors: (V, 4) linear RGBA factors of the vertices; None for white.
        smooth: (V,) number of the smooth patch of a vertex: vertices of one number share their
            normal in every state. -1 where faces keep their own.
    """

    materials: tuple[Material, ...]
    material_of_face: NDArray[np.int64]
    uv: tuple[FloatArray, ...] = ()
    colors: FloatArray | None = None
    smooth: NDArray[np.int64] | None = None

    @property
    def has_holes(self) -> bool:
        """Whether any material lets rays pass."""
        return any(one.cutoff > 0 for one in self.materials)

    def left_out(self) -> list[str]:
        """What of the paint pictures do not show, in sentences."""
        said: list[str] = []
        for number in np.unique(self.material_of_face):
            one = self.materials[number]
            if one.color[3] < one.cutoff:  # A texture makes it less, never more.
                said.append(
                    f"what has the material {number} is not to be seen: its alpha "
                    f"{one.color[3]:g} is below {one.cutoff:g}, where it is cut out; make it opaque"
                )
            if one.emits:
                said.append(f"the material {number} shines by itself, which is left out")
        return said

    def rgba(
        self, faces: NDArray[np.int64], face: NDArray[np.int64], weights: FloatArray
    ) -> FloatArray:
        """Linear RGBA (M, 4) at places of the surface.

        Args:
            faces: (F, 3) of the mesh.
            face: (M,) which faces.
            weights: (M, 3) barycentric coordinates.
        """
        corners, kind = faces[face], self.material_of_face[face]
        found = np.empty((len(face), 4))
        for number in np.unique(kind):
            here, material = kind == number, self.materials[number]
            values = np.tile(np.array(material.color), (int(here.sum()), 1))
            if material.texture is not None:
                uv = self.uv[material.texture.uv_set]
                values = values * material.texture.at(_mixed(uv, corners[here], weights[here]))
            found[here] = values
        if self.colors is not None:
            found = found * _mixed(self.colors, corners, weights)
        return found

    def passes(self, face: NDArray[np.int64], alpha: FloatArray) -> NDArray[np.bool_]:
        """Which hits (M,) of an alpha are no hits, as the material lets the ray through."""
        cutoff = np.array([one.cutoff for one in self.materials])[self.material_of_face[face]]
        return (cutoff > 0) & (alpha < cutoff)

    def cut_out(self, faces: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which faces (F,) of the mesh let rays pass somewhere, by a look at places all over."""
        found = np.zeros(len(faces), dtype=np.bool_)
        cutting = [number for number, one in enumerate(self.materials) if one.cutoff > 0]
        face = np.flatnonzero(np.isin(self.material_of_face, cutting))
        steps = np.arange(_CUTS + 1) / _CUTS
        for first, second in [(a, b) for a in steps for b in steps if a + b <= 1]:
            weights = np.tile((first, second, 1 - first - second), (len(face), 1))
            found[face] |= self.passes(face, self.rgba(faces, face, weights)[:, 3])
        return found


def mesh_normals(vertices: FloatArray, faces: NDArray[np.int64]) -> FloatArray:
    """Unit normals (F, 3) of faces; zero where a face has no area."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normal / np.linalg.norm(normal, axis=1, keepdims=True).clip(1e-300)


def corner_normals(
    vertices: FloatArray, faces: NDArray[np.int64], smooth: NDArray[np.int64] | None
) -> FloatArray:
    """Unit normals (F, 3, 3) at the corners of faces, shared over smooth patches (V,)."""
    flat = np.repeat(mesh_normals(vertices, faces)[:, None], 3, axis=1)
    if smooth is None or not (smooth >= 0).any():
        return flat
    corners = vertices[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    patch = smooth[faces]
    total = np.zeros((int(smooth.max()) + 1, 3))
    for k in range(3):
        known = patch[:, k] >= 0
        np.add.at(total, patch[known, k], areas[known])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    shared = (total / length.clip(1e-300))[patch.clip(0)]
    # Where the faces of a patch cancel out each keeps its own.
    usable = (patch >= 0) & (length[patch.clip(0), 0] > 0)
    return np.where(usable[..., None], shared, flat)


def smooth_patches(vertices: FloatArray, normals: FloatArray | None) -> NDArray[np.int64]:
    """Number of the smooth patch (V,) of vertices: equal places, and equal normals where known.

    Args:
        vertices: (V, 3).
        normals: (V, 3), zero where a vertex has none and its faces are flat; None: all are smooth.
    """
    size = float(np.ptp(vertices, axis=0).max()) or 1.0
    rows = np.round(vertices / size * 1e6)
    if normals is not None:
        rows = np.column_stack([rows, np.round(normals * 1e3)])
    _, patch = np.unique(rows, axis=0, return_inverse=True)
    patch = patch.reshape(-1).astype(np.int64)
    return patch if normals is None else np.where((normals != 0).any(axis=1), patch, -1)


def linear_rgba(pixels: NDArray[np.uint8]) -> FloatArray:
    """Bytes of sRGB (..., 4) as linear light, alpha as it is; both 0 to 1."""
    return np.concatenate([_LINEAR[pixels[..., :3]], pixels[..., 3:] / 255.0], axis=-1)


def display(light: FloatArray) -> FloatArray:
    """Linear light as sRGB values, clipped to 0 to 1."""
    light = np.clip(light, 0.0, 1.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def linear(values: FloatArray) -> FloatArray:
    """Values of sRGB from 0 to 1 as linear light."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


_LINEAR = linear(np.arange(256) / 255.0)


def _mixed(values: FloatArray, corners: NDArray[np.int64], weights: FloatArray) -> FloatArray:
    """Values (M, C) of vertices (V, C) at barycentric coordinates (M, 3) of corners (M, 3)."""
    return np.einsum("mi,mic->mc", weights, values[corners])


def _wrapped(index: NDArray[np.int64], size: int, wrap: str) -> NDArray[np.int64]:
    if wrap == "clamp":
        return np.clip(index, 0, size - 1)
    if wrap == "mirror":
        folded = np.mod(index, 2 * size)
        return np.where(folded < size, folded, 2 * size - 1 - folded)
    return np.mod(index, size)
