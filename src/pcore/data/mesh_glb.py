"""Meshes with colours as binary glTF, moving ones with morph targets.

The light of the photos is in the colours, so that the material is unlit (KHR_materials_unlit);
a viewer that knows no such material shows a rough surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from pcore.data.gltf_writer import INDICES, VERTICES, GltfWriter
from pcore.data.pictures import linear_colors, png_content
from pcore.geometry.surface_mesh import SurfaceMesh

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
