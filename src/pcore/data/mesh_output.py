"""Meshes with colours into files: PLY, OBJ, glTF and USD, also as they move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor
from trimesh import Trimesh
from trimesh.exchange.obj import export_obj
from trimesh.exchange.ply import export_ply
from trimesh.visual import ColorVisuals, TextureVisuals
from trimesh.visual.material import SimpleMaterial

from pcore.data.gltf_writer import INDICES, VERTICES, GltfWriter
from pcore.data.mesh_usd import write_usd
from pcore.data.pictures import linear_colors, png_content, to_bytes
from pcore.data.whole_file import replacing, write_whole
from pcore.errors import InputError
from pcore.geometry.surface_mesh import SurfaceMesh

USD_SUFFIXES = (".usd", ".usda", ".usdc")
MESH_OUTPUTS = (".ply", ".obj", ".glb", *USD_SUFFIXES)
_MOVING = (".glb", *USD_SUFFIXES)
"""Formats that hold all frames in one file."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshMotion:
    """Where the vertices of a mesh are over time.

    Attributes:
        frames: (V, 3) each, at least one, world units.
        fps: frames per second.
    """

    frames: tuple[Tensor, ...]
    fps: float = 30.0


def check_mesh_output(path: Path) -> None:
    """Raise InputError unless a mesh can be written to a file of this name."""
    if path.suffix.lower() not in MESH_OUTPUTS:
        raise InputError(
            f"{path}: expected a mesh file that ends in {', '.join(MESH_OUTPUTS)}, got "
            f"{path.suffix or 'no ending'!r}"
        )


def save_mesh(path: Path | str, mesh: SurfaceMesh, motion: MeshMotion | None = None) -> list[Path]:
    """Write a mesh; replaces files at once.

    World units throughout. PLY, OBJ and USD have z up; a glTF file has y up, (x, y, z) is written
    as (x, z, -y), which importers turn back.

    Args:
        path: where to; the ending decides the format, the folder must exist.
        mesh: with a texture or colours at its vertices; PLY has these alone.
        motion: frames of the same vertices. In glTF they are morph targets, in USD samples over
            time; PLY and OBJ get a file for each, NAME_000, NAME_001 and so on.

    Returns:
        The files.

    Raises:
        InputError: another ending, or a place that is not writable.
        DependencyError: USD, and its package is missing.
    """
    path = Path(path)
    check_mesh_output(path)
    kind = path.suffix.lower()
    if motion is not None and kind not in _MOVING:
        names = numbered(path, len(motion.frames))
        poses = zip(names, motion.frames, strict=True)
        return [file for name, vertices in poses for file in save_mesh(name, mesh.moved(vertices))]
    frames, fps = ((), 30.0) if motion is None else (motion.frames, motion.fps)
    if kind == ".glb":
        write_whole(path, glb_of(mesh, frames, fps), "mesh")
        return [path]
    if kind in USD_SUFFIXES:
        return _save_usd(path, mesh, frames, fps)
    if kind == ".ply":
        plain = trimesh_of(replace(mesh, texture=None))
        write_whole(path, export_ply(plain, vertex_normal=True), "mesh")
        return [path]
    return _save_obj(path, mesh)


def numbered(path: Path, count: int) -> list[Path]:
    """Names of so many files of a sequence: NAME_000.ply, NAME_001.ply, ..."""
    digits = max(3, len(str(count - 1)))
    return [path.with_name(f"{path.stem}_{k:0{digits}}{path.suffix}") for k in range(count)]


def trimesh_of(mesh: SurfaceMesh) -> Any:
    """Return the mesh as trimesh has it, its vertices in order."""
    texture = mesh.texture
    if texture is None:
        visual = ColorVisuals(vertex_colors=to_bytes(mesh.colors).numpy())
    else:
        picture = Image.fromarray(to_bytes(texture.image).numpy())
        visual = TextureVisuals(
            uv=texture.coordinates.numpy(), material=SimpleMaterial(image=picture)
        )
    return Trimesh(
        vertices=mesh.vertices.numpy(),
        faces=mesh.faces.numpy(),
        vertex_normals=mesh.normals.numpy(),
        visual=visual,
        process=False,
    )


def _save_obj(path: Path, mesh: SurfaceMesh) -> list[Path]:
    body = trimesh_of(mesh)
    if mesh.texture is not None:
        # The names of the files beside it come from the material.
        body.visual.material.name = f"{path.stem}_texture"
    text, beside = export_obj(
        body, return_texture=True, include_normals=True, mtl_name=f"{path.stem}.mtl", digits=9
    )
    files = [path]
    for name, content in beside.items():
        files.append(path.with_name(name))
        write_whole(files[-1], content, "material of the mesh")
    write_whole(path, text.encode(), "mesh")
    return files


def _save_usd(path: Path, mesh: SurfaceMesh, frames: Sequence[Tensor], fps: float) -> list[Path]:
    files = [path]
    if mesh.texture is not None:
        files.append(path.with_name(f"{path.stem}_texture.png"))
        write_whole(files[-1], png_content(mesh.texture.image), "texture of the mesh")
    if not path.parent.is_dir():
        raise InputError(f"{path}: expected an existing folder to write to, got {path.parent}")
    try:
        with replacing(path) as partial:
            # The library chooses text or binary by the ending.
            written = partial.with_name(f"{partial.name}{path.suffix}")
            write_usd(written, mesh, frames, fps, texture=files[1].name if files[1:] else None)
            written.replace(partial)
    except OSError as error:
        raise InputError(
            f"{path}: cannot write the mesh ({error.strerror}); expected a place that can be "
            "written to"
        ) from error
    return files


_UNLIT = "KHR_materials_unlit"


def glb_of(mesh: SurfaceMesh, frames: Sequence[Tensor] = (), fps: float = 30.0) -> bytes:
    """Content of a `.glb` file of a mesh (z up; y up in the file).

    Args:
        mesh: at rest; where it moves, its own vertices are not written.
        frames: (V, 3) of its vertices over time: the first is the mesh, every other one a morph
            target, and an animation goes through all of them.
        fps: frames per second.
    """
    writer = GltfWriter()
    base = mesh.moved(frames[0]) if frames else mesh
    places = _turned(base.vertices)
    attributes = {
        "POSITION": writer.add(places, target=VERTICES, bounds=True),
        "NORMAL": writer.add(_turned(base.normals), target=VERTICES),
    }
    material: dict[str, Any] = {
        "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
        "extensions": {_UNLIT: {}},
        "doubleSided": True,
    }
    document: dict[str, Any] = {
        "extensionsUsed": [_UNLIT],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "object"}],
        "materials": [material],
    }
    if mesh.texture is None:
        colors = linear_colors(mesh.colors).numpy()
        attributes["COLOR_0"] = writer.add(colors, target=VERTICES)
    else:
        document |= _texture(writer, mesh.texture.image)
        material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
        u, v = mesh.texture.coordinates.numpy().T
        attributes["TEXCOORD_0"] = writer.add(np.stack([u, 1 - v], axis=1), target=VERTICES)
    primitive: dict[str, Any] = {
        "attributes": attributes,
        "indices": writer.add(mesh.faces.numpy().reshape(-1), target=INDICES),
        "material": 0,
    }
    shape: dict[str, Any] = {"primitives": [primitive]}
    document["meshes"] = [shape]
    if len(frames) > 1:
        targets = [
            writer.add(_turned(one) - places, target=VERTICES, bounds=True) for one in frames[1:]
        ]
        primitive["targets"] = [{"POSITION": one} for one in targets]
        shape["weights"] = [0.0] * len(targets)
        document["animations"] = [_animation(writer, len(frames), fps)]
    return writer.content(document)


def _animation(writer: GltfWriter, count: int, fps: float) -> dict[str, Any]:
    """Weights over time: at every frame that of its own target alone."""
    weights = np.eye(count)[:, 1:].reshape(-1)
    times = writer.add(np.arange(count) / fps, bounds=True)
    sampler = {"input": times, "output": writer.add(weights), "interpolation": "LINEAR"}
    channel = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
    return {"name": "edit", "samplers": [sampler], "channels": [channel]}


def _texture(writer: GltfWriter, image: Tensor) -> dict[str, Any]:
    view = writer.add_bytes(png_content(image))
    return {
        "images": [{"bufferView": view, "mimeType": "image/png"}],
        "samplers": [{"magFilter": 9729, "minFilter": 9987}],
        "textures": [{"source": 0, "sampler": 0}],
    }


def _turned(vectors: Tensor) -> NDArray[np.float64]:
    """From z up to y up."""
    x, y, z = vectors.double().numpy().T
    return np.stack([x, z, -y], axis=1)
