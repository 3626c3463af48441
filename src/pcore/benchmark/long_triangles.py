"""Whether the triangles of a model are short enough for the maps that move its vertices."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from pcore.benchmark.look import FloatArray
from pcore.deform.base import Deformation

_SHORT = 4.0
"""Edges of fewer pixels are not looked at: none but a bend of a radius as small moves their middle
by half a pixel."""
_SEEN = 0.5
"""Pixels from which on it is seen."""


@dataclass(frozen=True, kw_only=True)
class _Departure:
    """How far straight triangles are from what a map makes of them.

    Attributes:
        state: name of the state.
        pixels: largest distance of the middle of an edge.
        share: of the surface at rest, of triangles with an edge that is seen to be off.
    """

    state: str
    pixels: float
    share: float


def long_triangles(
    vertices: FloatArray,
    faces: NDArray[np.int64],
    maps: Mapping[str, Deformation],
    pixels: Mapping[str, float],
) -> list[str]:
    """Say in which states the pictures show another shape than the map of the state makes.

    A model's triangles stay straight when their corners move; where they are long a method that
    follows the map is scored against a shape that the map does not make.

    Args:
        vertices: (V, 3) at rest.
        faces: (F, 3).
        maps: of the states that have one, by name.
        pixels: width of a pixel of each state's pictures, at the object, in the unit of the
            vertices.
    """
    found = [_departure(vertices, faces, name, one, pixels[name]) for name, one in maps.items()]
    odd = [one for one in found if one.pixels > _SEEN]
    if not odd:
        return []
    told = ", ".join(
        f"{one.state} {one.pixels:.1f} pixels, {math.ceil(100 * one.share)} % of the surface"
        for one in odd
    )
    return [
        "triangles are so long that they stay straight where the map of a state bends them, so "
        f"that every method is scored against another shape than the map makes ({told}); subdivide "
        "the model first (Blender: modifier Subdivision Surface, Simple), and with it what edits "
        "`mesh` and `displacement` were made of"
    ]


def _departure(
    vertices: FloatArray, faces: NDArray[np.int64], state: str, moving: Deformation, pixel: float
) -> _Departure:
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=-1)
    edges, number = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
    start, end = vertices[edges[:, 0]], vertices[edges[:, 1]]
    off = np.zeros(len(edges))
    long = np.linalg.norm(end - start, axis=1) > _SHORT * pixel
    if long.any():
        start, end = start[long], end[long]
        places = torch.from_numpy(np.concatenate([start, end, 0.5 * (start + end)]))
        first, last, middle = moving(places).detach().numpy().reshape(3, -1, 3)
        off[long] = np.linalg.norm(middle - 0.5 * (first + last), axis=1) / pixel
    corners = vertices[faces]
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    seen = (off[number].reshape(-1, 3) > _SEEN).any(axis=1)
    return _Departure(
        state=state, pixels=float(off.max()), share=min(1.0, float(areas[seen].sum() / areas.sum()))
    )
