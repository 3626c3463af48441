"""Samples of the true surface that `meshes.npz` of an evaluation scene brings along."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcore.errors import SceneError
from pcore.evaluation.ground_truth import DeformedTruth, FloatArray, read_arrays
from pcore.geometry.surface_search import IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceSamples:
    """Points of the canonical mesh that some training camera sees.

    Attributes:
        face: (T,) triangle of each sample.
        barycentric: (T, 3) weights of its corners.
    """

    face: IntArray
    barycentric: FloatArray

    def positions(self, truth: DeformedTruth, state: str | None) -> FloatArray:
        """Return the samples (T, 3) on the mesh of a state (None: canonical), world units.

        Raises:
            InputError: there is no such state.
        """
        corners = truth.vertices(state)[truth.faces[self.face]]
        return np.einsum("nk,nkd->nd", self.barycentric, corners)


def load_samples(root: Path) -> SurfaceSamples:
    """Read the visible samples of a scene folder; hidden inner surfaces are left out.

    Raises:
        SceneError: the file is missing, damaged, or without samples that fit its mesh.
    """
    path = root / "meshes.npz"
    arrays = read_arrays(path)
    names = ("faces", "sample_face", "sample_barycentric", "sample_visible")
    lacking = [name for name in names if name not in arrays]
    if lacking:
        raise SceneError(
            f"{path}: expected samples of the true surface, got no {', '.join(lacking)}; "
            "cloud metrics need them"
        )
    faces, face, weights, visible = (arrays[name] for name in names)
    count = len(face)
    if face.ndim != 1 or weights.shape != (count, 3) or visible.shape != (count,):
        raise SceneError(
            f"{path}: expected sample_face (T,), sample_barycentric (T, 3) and sample_visible "
            f"(T,), got {face.shape}, {weights.shape} and {visible.shape}"
        )
    seen = visible.astype(bool)
    if not seen.any() or face.min() < 0 or face.max() >= len(faces):
        raise SceneError(
            f"{path}: expected visible samples on triangles 0 to {len(faces) - 1}, got "
            f"{int(seen.sum())} of {count} visible"
        )
    return SurfaceSamples(
        face=face[seen].astype(np.int64), barycentric=weights[seen].astype(np.float64)
    )
