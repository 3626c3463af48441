"""The truth about deformed objects: their meshes, the motion of points near them, their depth.

Reads `meshes.npz` of a scene (canonical mesh and states, one vertex order) and
`STATE/deformation.json` beside it: the layout of the embedded sample and the evaluation sets.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pcore.deform.base import Deformation
from pcore.deform.proxy import face_frames
from pcore.errors import InputError, SceneError
from pcore.evaluation.deformation_record import DeformationRecord
from pcore.evaluation.mesh_depth import mesh_depth
from pcore.geometry.camera import Camera
from pcore.geometry.neighbours import as_points
from pcore.geometry.surface_search import SurfacePoints, SurfaceSearch
from pcore.validation import parse, read_json

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_CUT_OUT = "cut_out"
_SAMPLES = ("sample_face", "sample_barycentric", "sample_visible")
_NOT_STATES = ("canonical", "faces", _CUT_OUT, *_SAMPLES)
_STATE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
_LARGEST_SCALE = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceAnchors:
    """Where points hang on the canonical mesh.

    Attributes:
        surface: closest points on the mesh.
        offset: (N, 3) from the closest point to the point, world units.
    """

    surface: SurfacePoints
    offset: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class DeformedTruth:
    """A mesh and its deformed states, world units.

    Attributes:
        root: the scene's folder.
        canonical: (V, 3) vertices before deformation.
        faces: (F, 3) corners of the triangles.
        states: (V, 3) vertices by state, same order as `canonical`.
        cut_out: (F,) triangles in which something is cut out by its texture; None: none.
    """

    root: Path
    canonical: FloatArray
    faces: IntArray
    states: Mapping[str, FloatArray]
    cut_out: NDArray[np.bool_] | None = None

    def object_size(self, state: str | None = None) -> float:
        """Diagonal of the bounding box of a state (None: canonical), world units."""
        return float(np.linalg.norm(np.ptp(self.vertices(state), axis=0)))

    def vertices(self, state: str | None) -> FloatArray:
        """(V, 3) vertices of a state, of the canonical mesh when None.

        Raises:
            InputError: there is no such state.
        """
        if state is None:
            return self.canonical
        if state not in self.states:
            raise InputError(
                f"{self.root}: no state {state!r}; it has {', '.join(self.states) or 'none'}"
            )
        return self.states[state]

    def depth(self, state: str | None, camera: Camera) -> Tensor:
        """Return the true depth (H, W) of a state (None: canonical); see `mesh_depth`."""
        return mesh_depth(self.vertices(state), self.faces, camera, cut_out=self.cut_out)

    def anchor(self, points: Tensor) -> SurfaceAnchors:
        """Hang points (N, 3), world units, on the canonical mesh: exact closest points.

        Raises:
            InputError: another shape, or NaN or infinity.
        """
        positions = as_points(points)
        surface = self._search.closest(positions)
        foot = _interpolate(self.canonical, self.faces, surface)
        return SurfaceAnchors(surface=surface, offset=positions - foot)

    def follow(self, anchors: SurfaceAnchors, state: str) -> Tensor:
        """Positions (N, 3) float32 of anchored points in a state.

        The closest point keeps its barycentric coordinates. The offset from it turns with the
        triangle (the rotation nearest to the triangle's deformation, which takes the normal to
        the deformed normal) and scales with the square root of the triangle's area, within a
        factor of 4, so that uniform scaling and rigid motion come out exactly.

        Raises:
            InputError: there is no such state.
        """
        vertices = self.vertices(state)
        foot = _interpolate(vertices, self.faces, anchors.surface)
        corners = self.faces[anchors.surface.face]
        before, area_before = face_frames(self.canonical[corners])
        after, area_after = face_frames(vertices[corners])
        left, _, right = np.linalg.svd(after @ np.linalg.pinv(before))
        # A mirrored result can only come from a triangle that lost its area: undo the mirror.
        left[..., 2] *= np.where(np.linalg.det(left @ right) < 0, -1.0, 1.0)[:, None]
        turned = np.einsum("nij,njk,nk->ni", left, right, anchors.offset)
        ratio = np.sqrt(area_after / np.maximum(area_before, np.finfo(np.float64).tiny))
        scale = np.clip(ratio, 1 / _LARGEST_SCALE, _LARGEST_SCALE)
        return torch.from_numpy((foot + scale[:, None] * turned).astype(np.float32))

    def carry(self, points: Tensor, state: str) -> Tensor:
        """Move points (N, 3) near the canonical mesh to where a state takes them, (N, 3) float32.

        For many states of the same points, call `anchor` once and `follow` for each.

        Raises:
            InputError: another shape, NaN or infinity, or there is no such state.
        """
        self.vertices(state)
        return self.follow(self.anchor(points), state)

    def record(self, state: str) -> DeformationRecord:
        """Read how a state was made.

        Raises:
            InputError: there is no such state.
            SceneError: its `deformation.json` is missing or damaged.
        """
        self.vertices(state)
        path = self.root / state / "deformation.json"
        found = read_json(path, what=f"description of the state {state!r}", error=SceneError)
        return parse(DeformationRecord, found, where=str(path), error=SceneError)

    def analytic(self, state: str) -> Deformation | None:
        """Build the deformation of a state from its formula; None for animations.

        Raises:
            InputError: there is no such state.
            SceneError: its `deformation.json` is missing, damaged or makes no deformation.
        """
        record = self.record(state)
        try:
            return record.deformation()
        except InputError as error:
            raise SceneError(f"{self.root / state / 'deformation.json'}: {error}") from error

    @cached_property
    def _search(self) -> SurfaceSearch:
        return SurfaceSearch(self.canonical, self.faces)


def load_truth(root: Path) -> DeformedTruth:
    """Read `meshes.npz` of a scene folder.

    Raises:
        SceneError: the file is missing, damaged or inconsistent.
    """
    path = root / "meshes.npz"
    arrays = read_arrays(path)
    canonical = _vertices(path, "canonical", arrays.get("canonical"), None)
    faces = arrays.get("faces")
    if faces is None or faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise SceneError(f"{path}: expected integer triangles 'faces' (F, 3), got {_what(faces)}")
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= len(canonical):
        raise SceneError(
            f"{path}: expected at least one triangle with corners from 0 to {len(canonical) - 1}"
        )
    cut_out = arrays.get(_CUT_OUT)
    if cut_out is not None and (cut_out.shape, cut_out.dtype) != ((len(faces),), np.bool_):
        raise SceneError(
            f"{path}: expected a truth value for each of {len(faces)} triangles in {_CUT_OUT!r}, "
            f"got {_what(cut_out)}"
        )
    states = {k: v for k, v in arrays.items() if k not in _NOT_STATES}
    for name in states:
        if not _STATE_NAME.fullmatch(name):
            raise SceneError(
                f"{path}: expected states named with letters, digits, '_', '-', '.', got {name!r}"
            )
    return DeformedTruth(
        root=root,
        canonical=canonical,
        faces=faces.astype(np.int64),
        states={k: _vertices(path, k, v, len(canonical)) for k, v in states.items()},
        cut_out=cut_out,
    )


def _interpolate(vertices: FloatArray, faces: IntArray, surface: SurfacePoints) -> FloatArray:
    return np.einsum("nk,nkd->nd", surface.barycentric, vertices[faces[surface.face]])


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Read all arrays of a NumPy archive; SceneError when it is missing or damaged."""
    try:
        with path.open("rb") as stream:
            if not zipfile.is_zipfile(stream):
                raise ValueError("not a whole archive")
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as file:
                return {name: file[name] for name in file.files}
    except FileNotFoundError as error:
        raise SceneError(
            f"{path}: not found; it must hold 'canonical', 'faces' and one array per state"
        ) from error
    except Exception as error:  # damaged bytes make the readers raise almost anything
        raise SceneError(
            f"{path}: expected a NumPy archive of plain arrays, got a file that is "
            "damaged or holds something else; copy it again"
        ) from error


def _vertices(path: Path, name: str, value: NDArray[Any] | None, count: int | None) -> FloatArray:
    wanted = "V" if count is None else str(count)
    shape_ok = value is not None and value.ndim == 2 and value.shape[1] == 3
    if value is None or not shape_ok or value.dtype.kind != "f" or count not in (None, len(value)):
        raise SceneError(
            f"{path}: expected vertices {name!r} of shape ({wanted}, 3), got {_what(value)}"
        )
    if not np.isfinite(value).all():
        raise SceneError(f"{path}: expected finite vertices {name!r}, got NaN or infinity")
    return value.astype(np.float64)


def _what(value: NDArray[Any] | None) -> str:
    return "nothing" if value is None else f"{value.dtype} of shape {value.shape}"
