"""A model of somebody else: its shape, its paint and its clips, in one frame, z up."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.resolvers import FilePathResolver

from pcore.benchmark.gltf_look import read_look
from pcore.benchmark.look import (
    FloatArray,
    Look,
    Material,
    Texture,
    linear_rgba,
    smooth_patches,
)
from pcore.data.gltf import Glb, read_glb, read_gltf
from pcore.data.gltf_animation import Clip, at_time, read_clips
from pcore.data.gltf_mesh import read_shape
from pcore.data.meshes import read_mesh
from pcore.data.point_ply import PointPly, read_point_ply
from pcore.errors import InputError

Up = Literal["y", "z"]
_FRAME = 1e-3
"""Seconds beyond the end of a clip that are rounding."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """A painted mesh that may move.

    Attributes:
        name: of its file.
        vertices: (V, 3) as the file shows them, units of the file, z up.
        faces: (F, 3).
        look: what is painted on it.
        clips: its animations.
        glb: the file where it is a glTF; None for others, which have no clips.
        up: the axis that points up in the file.
    """

    name: str
    vertices: FloatArray
    faces: NDArray[np.int64]
    look: Look
    clips: tuple[Clip, ...] = ()
    glb: Glb | None = None
    up: Up = "y"

    def clip(self, name: str) -> Clip:
        """Return the clip of a name.

        Raises:
            InputError: there is none; the message lists those there are.
        """
        for one in self.clips:
            if one.name == name:
                return one
        known = ", ".join(repr(one.name) for one in self.clips) or "none"
        raise InputError(f"{self.name}: expected one of its clips ({known}), got {name!r}")

    def at(self, clip: Clip, time: float) -> FloatArray:
        """Vertices (V, 3) at a time of a clip, seconds.

        Raises:
            InputError: the clip has no such time.
        """
        assert self.glb is not None
        last = clip.span[1]
        if not 0 <= time <= last + _FRAME:
            raise InputError(
                f"{self.name}: expected a time of the clip {clip.name!r} from 0 to {last:g} "
                f"seconds, got {time:g}"
            )
        vertices, _ = read_shape(at_time(self.glb, clip, time))
        return _z_up(on_shape(vertices, self.faces), self.up)


def read_model(path: Path, *, up: Up | None = None) -> Model:
    """Read a model with its paint and clips.

    Args:
        path: a .glb or .gltf (textures, skins, morph targets, clips), .obj (with its .mtl) or .ply
            (colours of vertices).
        up: the axis that points up in the file; None: y, but z for .ply.

    Raises:
        InputError: missing, damaged, without triangles, NaN, or something that is not read.
    """
    shape = read_mesh(path)  # All that can be wrong with the shape is said there.
    suffix, content = path.suffix.lower(), path.read_bytes()
    if suffix == ".ply":
        points, faces = read_point_ply(content, str(path)), shape.faces.numpy()
        look = _vertex_paint(points.colors()[0], len(faces))
        return _static(path, shape.vertices.numpy(), faces, look, up or "z", _ply_normals(points))
    if suffix == ".obj":
        return _obj(path, up or "y")
    axis = up or "y"
    glb = (
        read_glb(content, str(path))
        if suffix == ".glb"
        else read_gltf(content, str(path), path.parent)
    )
    faces = shape.faces.numpy()
    vertices = on_shape(shape.vertices.numpy(), faces)
    return Model(
        name=path.stem,
        vertices=_z_up(vertices, axis),
        faces=faces,
        look=read_look(glb, vertices),
        clips=read_clips(glb),
        glb=glb,
        up=axis,
    )


def on_shape(vertices: FloatArray, faces: NDArray[np.int64]) -> FloatArray:
    """Vertices (V, 3) with those of no triangle put on one, where they widen nothing."""
    unused = np.ones(len(vertices), dtype=bool)
    unused[faces] = False
    return np.where(unused[:, None], vertices[faces[0, 0]], vertices)


def _z_up(vertices: FloatArray, up: Up) -> FloatArray:
    if up == "z":
        return vertices
    return np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1)


def _obj(path: Path, up: Up) -> Model:
    """An OBJ through trimesh, which splits its vertices at seams and hard edges."""
    files = _FilesBeside(path)
    try:
        loaded: Any = trimesh.load(path, process=False, resolver=files)
        parts = [*getattr(loaded, "geometry", {"": loaded}).values()]
        mesh: Any = trimesh.util.concatenate(parts)
    except Exception as error:
        raise InputError(f"{path}: expected a mesh with its paint, got: {error}") from None
    if files.missing:
        raise InputError(
            f"{path}: expected the files of its paint beside it, missing: "
            f"{', '.join(files.missing)}; bring them, or take out the lines that name them"
        )
    faces = np.asarray(mesh.faces, dtype=np.int64)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    # In trimesh's cache are normals of the file; asked for them, it would make up others.
    known = ["vertex_normals" in one._cache for one in parts]
    normals = None
    if any(known) or _says_flat(path):
        pairs = zip(parts, known, strict=True)
        rows = [p.vertex_normals if has else np.zeros((len(p.vertices), 3)) for p, has in pairs]
        normals = np.concatenate(rows).astype(np.float64)
    return _static(path, vertices, faces, _painted(mesh, len(faces)), up, normals)


class _FilesBeside(FilePathResolver):
    """Remembers what trimesh looks for in vain and paints over in grey."""

    def __init__(self, source: Path) -> None:
        super().__init__(str(source))
        self.missing: list[str] = []

    def get(self, name: str) -> bytes:
        try:
            return super().get(name)
        except OSError:
            self.missing.append(name)
            raise


def _says_flat(path: Path) -> bool:
    """Whether smoothing is switched off in an OBJ, and never on."""
    lines = (line.split() for line in path.read_bytes().decode("latin-1").splitlines())
    groups = {words[1] for words in lines if len(words) > 1 and words[0] == "s"}
    return bool(groups) and groups <= {"off", "0"}


def _ply_normals(points: PointPly) -> FloatArray | None:
    names = points.normals()
    if names is None:
        return None
    # Scanners write NaN where they know no normal; 0 says so.
    return np.nan_to_num(points.values(names).astype(np.float64), posinf=0.0, neginf=0.0)


def _static(
    path: Path,
    vertices: FloatArray,
    faces: NDArray[np.int64],
    look: Look,
    up: Up,
    normals: FloatArray | None,
) -> Model:
    vertices = on_shape(vertices, faces)
    return Model(
        name=path.stem,
        vertices=_z_up(vertices, up),
        faces=faces,
        look=replace(look, smooth=smooth_patches(vertices, normals)),
        up=up,
    )


def _vertex_paint(colors: NDArray[np.uint8] | None, faces: int) -> Look:
    """Bytes of sRGB (V, 3) or (V, 4) on the vertices; grey without."""
    one = np.zeros(faces, dtype=np.int64)
    if colors is None:
        return Look(materials=(Material(),), material_of_face=one)
    solid = np.full((len(colors), 1), 255, dtype=np.uint8)
    rgba = np.hstack([colors[:, :3], colors[:, 3:] if colors.shape[1] > 3 else solid])
    white = Material(color=(1.0, 1.0, 1.0, 1.0))
    return Look(materials=(white,), material_of_face=one, colors=linear_rgba(rgba))


def _painted(mesh: Any, faces: int) -> Look:
    visual, one = mesh.visual, np.zeros(faces, dtype=np.int64)
    image = getattr(getattr(visual, "material", None), "image", None)
    if visual.kind == "texture" and image is not None and visual.uv is not None:
        pixels = np.asarray(image.convert("RGBA"))
        uv = np.asarray(visual.uv, dtype=np.float64)
        # v points up in OBJ and trimesh.
        uv = np.column_stack([uv[:, 0], 1.0 - uv[:, 1]])
        material = Material(color=(1.0, 1.0, 1.0, 1.0), texture=Texture(pixels=pixels))
        return Look(materials=(material,), material_of_face=one, uv=(uv,))
    if visual.kind == "vertex":
        return _vertex_paint(np.asarray(visual.vertex_colors, dtype=np.uint8), faces)
    plain = getattr(getattr(visual, "material", None), "main_color", None)
    if plain is not None:
        red, green, blue, alpha = linear_rgba(np.asarray(plain, dtype=np.uint8)[None])[0]
        material = Material(color=(float(red), float(green), float(blue), float(alpha)))
        return Look(materials=(material,), material_of_face=one)
    return Look(materials=(Material(),), material_of_face=one)
