"""Sets of points in files: NumPy `.npy` arrays (N, 3) and PLY point clouds or meshes."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from torch import Tensor
from trimesh.exchange.gltf import export_glb
from trimesh.exchange.ply import export_ply, load_ply

from pcore.errors import InputError

POINT_SUFFIXES = (".npy", ".ply")


@dataclass(frozen=True, kw_only=True)
class PointFile:
    """What a file of points holds.

    Attributes:
        positions: (N, 3) world units, float32 or float64 as in the file.
        colors: (N, 3) or (N, 4) uint8 of a PLY with vertex colours, else None.
        faces: (F, 3) int64 of a PLY that is a mesh (quads are split), else None.
    """

    positions: Tensor
    colors: Tensor | None = None
    faces: Tensor | None = None


def load_points(path: Path | str) -> Tensor:
    """Read positions (N, 3) float32, world units: an `.npy` array or the vertices of a `.ply`.

    Raises:
        InputError: see `read_point_file`.
    """
    points = read_point_file(path).positions.float()
    if not bool(torch.isfinite(points).all()):
        raise InputError(
            f"{path}: expected world units, got numbers too large for single precision"
        )
    return points


def read_point_file(path: Path | str) -> PointFile:
    """Read positions with their precision and, from a PLY, vertex colours and faces.

    Raises:
        InputError: missing file, another suffix than .npy or .ply, damaged or pickled content
            (never executed), another shape than (N, 3), no points, NaN or infinity.
    """
    path = Path(path)
    check_point_path(path)
    content = _content(path)
    if path.suffix.lower() == ".npy":
        return PointFile(positions=_checked(path, _parse_npy(path, content)))
    return _parse_ply(path, content)


def read_array(path: Path | str) -> NDArray[Any]:
    """Read one NumPy array of any shape and type from a `.npy` file, never a pickle.

    Raises:
        InputError: missing file, another suffix, damaged content.
    """
    path = Path(path)
    if path.suffix.lower() != ".npy":
        raise InputError(f"{path}: expected a NumPy array in a .npy file")
    return _parse_npy(path, _content(path))


def save_points(
    path: Path | str, points: Tensor, colors: Tensor | None = None, faces: Tensor | None = None
) -> None:
    """Write points (N, 3) to `.npy` (their dtype) or `.ply` (float32); replaces the file at once.

    Args:
        path: where to; the suffix decides the format, the folder must exist.
        points: (N, 3) world units.
        colors: (N, 3) or (N, 4) uint8, kept by `.ply` only.
        faces: (F, 3) vertex numbers, kept by `.ply` only.

    Raises:
        InputError: another suffix or shape, NaN or infinity, or a place that is not writable.
    """
    path = Path(path)
    check_point_path(path)
    array = points.detach().cpu().numpy()
    _checked(path, array)
    if path.suffix.lower() == ".npy":
        buffer = io.BytesIO()
        np.save(buffer, array, allow_pickle=False)
        content = buffer.getvalue()
    else:
        content = _ply_content(path, array, colors, faces)
    _replace(path, content)


def save_point_glb(path: Path | str, points: Tensor, colors: Tensor | None = None) -> None:
    """Write points (N, 3) as binary glTF (.glb, float32); replaces the file at once.

    A glTF file has y up: (x, y, z) is written as (x, z, -y), which importers turn back.

    Args:
        path: where to, ending in .glb; the folder must exist.
        points: (N, 3) world units, z up.
        colors: (N, 3) or (N, 4) uint8.

    Raises:
        InputError: another suffix or shape, NaN or infinity, or a place that is not writable.
    """
    path = Path(path)
    if path.suffix.lower() != ".glb":
        raise InputError(f"{path}: expected a file of points that ends in .glb")
    array = points.detach().cpu().numpy()
    _checked(path, array)
    turned = np.stack([array[:, 0], array[:, 2], -array[:, 1]], axis=1)
    body = trimesh.PointCloud(turned, colors=_paint(path, array, colors))
    _replace(path, export_glb(trimesh.Scene(body)))


def _replace(path: Path, content: bytes) -> None:
    if not path.parent.is_dir():
        raise InputError(f"{path}: expected an existing folder to write to, got {path.parent}")
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise InputError(
            f"{path}: cannot write the points ({error.strerror}); "
            "expected a place that can be written to"
        ) from error


def check_point_path(path: Path) -> None:
    """Raise InputError unless the name ends in .npy or .ply."""
    if path.suffix.lower() not in POINT_SUFFIXES:
        raise InputError(
            f"{path}: expected a file of points that ends in .npy or .ply, "
            f"got {path.suffix or 'no ending'!r}"
        )


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; expected a .npy or .ply of points") from error
    except OSError as error:
        raise InputError(f"{path}: cannot read the file of points: {error.strerror}") from error


def _parse_npy(path: Path, content: bytes) -> NDArray[Any]:
    try:
        # allow_pickle=False: an .npy can carry a pickle, and unpickling runs what is in it.
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except (ValueError, EOFError, OSError, SyntaxError) as error:
        raise InputError(
            f"{path}: expected a NumPy array of numbers (pickles are never read), got a file that "
            f"is damaged or holds something else: {error}"
        ) from error
    if not isinstance(array, np.ndarray):
        raise InputError(f"{path}: expected one NumPy array (N, 3), got an archive (.npz) of them")
    return cast("NDArray[Any]", array)


def _parse_ply(path: Path, content: bytes) -> PointFile:
    try:
        # Materials are skipped because they would be looked up as further files.
        parsed = load_ply(io.BytesIO(content), fix_texture=False, skip_materials=True)
        declared = parsed["metadata"]["_ply_raw"]["vertex"]["length"] if "vertices" in parsed else 0
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, EOFError) as error:
        raise InputError(
            f"{path}: expected a PLY with vertices x, y, z, got a file that is damaged or holds "
            f"something else: {error}"
        ) from error
    vertices = np.asarray(parsed.get("vertices", np.zeros((0, 3), dtype=np.float32)))
    if len(vertices) != declared:
        raise InputError(
            f"{path}: expected {declared} vertices as its header says, got {len(vertices)}; "
            "the file is truncated"
        )
    colors, faces = parsed.get("vertex_colors"), parsed.get("faces")
    return PointFile(
        positions=_checked(path, vertices),
        colors=None if colors is None else torch.from_numpy(np.array(colors, dtype=np.uint8)),
        faces=None if faces is None else _triangles(path, faces, len(vertices)),
    )


def _triangles(path: Path, faces: Any, vertices: int) -> Tensor | None:
    triangles = np.asarray(trimesh.geometry.triangulate_quads(faces), dtype=np.int64)
    if triangles.size == 0:
        return None
    if triangles.min() < 0 or triangles.max() >= vertices:
        raise InputError(
            f"{path}: expected faces that refer to vertices 0 to {vertices - 1}, "
            f"got {triangles.min()} to {triangles.max()}"
        )
    return torch.from_numpy(triangles)


def _ply_content(
    path: Path, array: NDArray[Any], colors: Tensor | None, faces: Tensor | None
) -> bytes:
    paint = _paint(path, array, colors)
    if faces is None:
        body: Any = trimesh.PointCloud(array, colors=paint)
    else:
        triangles = faces.detach().cpu().numpy()
        # process=False: merging vertices would change their number and order.
        body = trimesh.Trimesh(array, triangles, process=False, vertex_colors=paint)
    return export_ply(body, vertex_normal=False)


def _paint(path: Path, array: NDArray[Any], colors: Tensor | None) -> NDArray[np.uint8] | None:
    paint = None if colors is None else colors.detach().cpu().numpy()
    if paint is not None and (paint.dtype != np.uint8 or paint.shape not in _paint_shapes(array)):
        raise InputError(
            f"{path}: expected colours (N, 3) or (N, 4) uint8 for {len(array)} points, "
            f"got {paint.shape} {paint.dtype}"
        )
    return paint


def _paint_shapes(array: NDArray[Any]) -> tuple[tuple[int, int], tuple[int, int]]:
    return (len(array), 3), (len(array), 4)


def _checked(path: Path, array: NDArray[Any]) -> Tensor:
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{path}: expected points of shape (N, 3), got shape {array.shape}")
    if len(array) == 0:
        raise InputError(f"{path}: expected at least one point, got none")
    if array.dtype.kind not in "fiu":
        raise InputError(f"{path}: expected real numbers, got the type {array.dtype}")
    wide = array.dtype.kind == "f" and array.dtype.itemsize >= 8
    positions = np.array(array, dtype=np.float64 if wide else np.float32)
    bad = int((~np.isfinite(positions)).any(axis=1).sum())
    if bad:
        raise InputError(
            f"{path}: expected finite coordinates, got NaN or infinity in {bad} of "
            f"{len(positions)} points; remove them first"
        )
    return torch.from_numpy(positions)
