"""An animated, textured, skinned model in a few lines: an upright bar of two bones on a plinth."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1] / "data"))
from gltf_files import SHAPES, Builder

SHAPES[2] = "VEC2"
TURN = 1.0
"""Angle of the upper bone at the end of the clip, radians about z of the file."""


def bar(rings: int = 8, sides: int = 12) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, texture coordinates and triangles of an open bar along y, radius 0.2, height 2."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    height = np.linspace(0, 2, rings + 1)
    place = np.array([(0.2 * np.cos(a), y, 0.2 * np.sin(a)) for y in height for a in angle])
    uv = np.array([(k / sides, y / 2) for y in height for k in range(sides + 1)])
    row = sides + 1
    faces = [
        face
        for i in range(rings)
        for k in range(sides)
        for face in (
            (i * row + k, (i + 1) * row + k, i * row + k + 1),
            (i * row + k + 1, (i + 1) * row + k, (i + 1) * row + k + 1),
        )
    ]
    return place, uv, np.array(faces)


def weights_of(place: np.ndarray) -> np.ndarray:
    """Shares (V, 4) of the two bones: the upper one from the middle on, blended over 0.5."""
    upper = np.clip((place[:, 1] - 0.75) / 0.5, 0, 1)
    return np.column_stack([1 - upper, upper, np.zeros((len(place), 2))])


def picture() -> bytes:
    """Left half red, right half blue, as PNG."""
    pixels = np.zeros((8, 8, 3), np.uint8)
    pixels[:, :4, 0], pixels[:, 4:, 2] = 220, 220
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG")
    return buffer.getvalue()


def figure(rings: int = 8, sides: int = 12) -> Builder:
    """The model: clips `Bow` (the upper bone turns), `Stay` (nothing moves)."""
    made = Builder()
    place, uv, faces = bar(rings, sides)
    made.primitive["attributes"] = {
        "POSITION": made.array(place),
        "TEXCOORD_0": made.array(uv),
        "JOINTS_0": made.array(np.tile([0, 1, 0, 0], (len(place), 1)), "u1"),
        "WEIGHTS_0": made.array(weights_of(place)),
    }
    made.primitive["indices"] = made.array(faces.ravel(), "u4")
    made.primitive["material"] = 0
    image = made.view(np.frombuffer(picture(), np.uint8), "u1")
    made.tree["images"] = [{"bufferView": image, "mimeType": "image/png"}]
    made.tree["textures"] = [{"source": 0}]
    made.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    rest = np.stack([np.eye(4), np.eye(4)])
    rest[1, 1, 3] = -1.0
    made.tree["skins"] = [
        {
            "joints": [1, 2],
            "inverseBindMatrices": made.array(rest.transpose(0, 2, 1).reshape(2, 16)),
        }
    ]
    made.tree["nodes"] = [
        {"mesh": 0, "skin": 0},
        {"children": [2]},
        {"translation": [0, 1, 0]},
    ]
    made.tree["scenes"] = [{"nodes": [0, 1]}]
    half = TURN / 2
    keys = [[0, 0, 0, 1], [0, 0, np.sin(half), np.cos(half)]]
    times = made.array(np.array([0.0, 2.0]))
    still = [[0, 0, 0, 1], [0, 0, 0, 1]]
    made.tree["animations"] = [
        {
            "name": name,
            "channels": [{"sampler": 0, "target": {"node": 2, "path": "rotation"}}],
            "samplers": [{"input": times, "output": made.array(np.array(values))}],
        }
        for name, values in (("Bow", keys), ("Stay", still))
    ]
    return made


def bowed(place: np.ndarray, angle: float) -> np.ndarray:
    """Vertices with the upper bone turned: linear blend skinning by hand, frame of the file."""
    share = weights_of(place)[:, 1:2]
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    pivot = np.array([0.0, 1.0, 0.0])
    return (1 - share) * place + share * ((place - pivot) @ turn.T + pivot)
