"""A model of somebody else: its shape, its paint and its clips, in one frame, z up."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pcore.benchmark.gltf_look import read_look
from pcore.benchmark.look import FloatArray, Look, Material, linear_rgba, smooth_patches
from pcore.benchmark.obj_look import painted_obj
from pcore.data.gltf import Glb, read_glb, read_gltf
from pcore.data.gltf_animation import Clip, at_time, read_clips
from pcore.data.gltf_mesh import read_shape
from pcore.data.meshes import read_mesh
from pcore.data.obj import parse_obj
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
    axis = up or ("z" if suffix == ".ply" else "y")
    if suffix == ".ply":
        points, faces = read_point_ply(content, str(path)), shape.faces.numpy()
        vertices = shape.vertices.numpy()
        look = _vertex_paint(_ply_colors(points, path), len(faces))
        look = replace(look, smooth=smooth_patches(vertices, _ply_normals(points)))
        return _static(path, vertices, faces, look, axis)
    if suffix == ".obj":
        obj = painted_obj(parse_obj(content, str(path)), path)
        return _static(path, obj.vertices, obj.faces, obj.look, axis)
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


def _ply_colors(points: PointPly, path: Path) -> NDArray[np.uint8] | None:
    """Colours (V, 3) or (V, 4) of the vertices; None of a file without paint."""
    colors, why = points.colors()
    comments = points.ply.header.comments
    texture = next((one for one in comments if one.lower().startswith("texturefile")), None)
    if colors is None and texture is not None:
        why = f"it is painted with a texture ({texture}), which is not read of a .ply"
    if colors is None and why:
        raise InputError(f"{path}: expected colours of vertices: {why}; export .obj or .glb")
    return colors


def _ply_normals(points: PointPly) -> FloatArray | None:
    names = points.normals()
    if names is None:
        return None
    # Scanners write NaN where they know no normal; 0 says so.
    return np.nan_to_num(points.values(names).astype(np.float64), posinf=0.0, neginf=0.0)


def _static(
    path: Path, vertices: FloatArray, faces: NDArray[np.int64], look: Look, up: Up
) -> Model:
    vertices = on_shape(vertices, faces)
    return Model(name=path.stem, vertices=_z_up(vertices, up), faces=faces, look=look, up=up)


def _vertex_paint(colors: NDArray[np.uint8] | None, faces: int) -> Look:
    """Bytes of sRGB (V, 3) or (V, 4) on the vertices; grey without."""
    one = np.zeros(faces, dtype=np.int64)
    if colors is None:
        return Look(materials=(Material(),), material_of_face=one)
    solid = np.full((len(colors), 1), 255, dtype=np.uint8)
    rgba = np.hstack([colors[:, :3], colors[:, 3:] if colors.shape[1] > 3 else solid])
    white = Material(color=(1.0, 1.0, 1.0, 1.0))
    return Look(materials=(white,), material_of_face=one, colors=linear_rgba(rgba))
