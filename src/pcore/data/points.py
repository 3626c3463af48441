"""Sets of points in files: NumPy `.npy` arrays (N, 3) and PLY point clouds or meshes."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pcore.data.file_kinds import kind_of
from pcore.data.pictures import to_bytes
from pcore.data.ply import binary_ply
from pcore.data.point_ply import PLACES, PointPly, read_point_ply
from pcore.data.whole_file import write_whole
from pcore.errors import InputError
from pcore.validation import read_bytes

_FILE = "a .npy or .ply of points"
_REALS = (*PLACES, "nx", "ny", "nz")
_PAINT = ("red", "green", "blue")

POINT_SUFFIXES = (".npy", ".ply")


@dataclass(frozen=True, kw_only=True)
class PointFile:
    """What a file of points holds.

    Attributes:
        positions: (N, 3) world units, float32 or float64 as in the file.
        colors: (N, 3) or (N, 4) uint8 of a PLY with vertex colours, else None. Colours of 16 bits
            or real numbers are brought to 8 bits.
        faces: (F, 3) int64 of a PLY that is a mesh (polygons are split), else None.
        ply: a PLY as it stands in the file, else None.
        notes: what of the file could not be understood, for the user.
    """

    positions: Tensor
    colors: Tensor | None = None
    faces: Tensor | None = None
    ply: PointPly | None = None
    notes: tuple[str, ...] = ()

    @property
    def has_normals(self) -> bool:
        """Whether `save_moved` wants Jacobians, to turn normals with."""
        return self.ply is not None and self.ply.normals() is not None

    def not_written(self, *, colors: bool = False, faces: bool = True) -> tuple[str, ...]:
        """Name what a PLY holds besides places, colours and faces, for a file without it.

        Args:
            colors: whether the other file has its colours.
            faces: whether it has its faces.
        """
        if self.ply is None:
            return ()
        lost = self.ply.beside(colors=colors, faces=faces)
        return (f"not in the file that is written: {', '.join(lost)}",) if lost else ()


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
    content = read_bytes(path, what=_FILE)
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
    return _parse_npy(path, read_bytes(path, what=_FILE))


def save_points(
    path: Path | str, points: Tensor, colors: Tensor | None = None, faces: Tensor | None = None
) -> None:
    """Write points (N, 3) to `.npy` or `.ply` in their precision; replaces the file at once.

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
    places = _checked(path, array)
    if path.suffix.lower() == ".npy":
        buffer = io.BytesIO()
        np.save(buffer, array, allow_pickle=False)
        content = buffer.getvalue()
    else:
        columns: dict[str, NDArray[Any]] = dict(zip(PLACES, places.numpy().T, strict=True))
        paint = _paint(path, array, colors)
        if paint is not None:
            columns |= dict(zip((*_PAINT, "alpha"), paint.T, strict=False))
        content = binary_ply(columns, None if faces is None else faces.detach().cpu().numpy())
    write_whole(path, content, "points")


def save_painted(
    path: Path, positions: Tensor, colors: Tensor, normals: Tensor, confidence: Tensor
) -> None:
    """Write points with what they look like as a PLY; replaces the file at once.

    Args:
        path: where to, .ply.
        positions: (N, 3) world units; written as float32.
        colors: (N, 3) in [0, 1].
        normals: (N, 3) unit.
        confidence: (N,) in [0, 1].

    Raises:
        InputError: numbers that are not finite, or a place that is not writable.
    """
    reals = torch.cat([positions, normals, confidence.unsqueeze(1)], dim=1).float().numpy()
    if not np.isfinite(reals[:, :6]).all():
        raise InputError(f"{path}: expected finite points, got NaN or infinity")
    columns: dict[str, NDArray[Any]] = dict(zip(_REALS, reals.T, strict=False))
    columns |= dict(zip(_PAINT, to_bytes(colors).numpy().T, strict=True))
    write_whole(path, binary_ply({**columns, "confidence": reals[:, 6]}), "points")


def save_moved(
    path: Path | str, source: PointFile, moved: Tensor, maps: Tensor | None = None
) -> tuple[str, ...]:
    """Write the points of a file at other places, with all else that the file holds.

    From PLY to PLY everything is kept: properties with their types, faces, other elements,
    comments. Normals are turned; what else would turn is kept as it is and named.

    Args:
        path: where to, .npy or .ply; the folder must exist.
        source: what was read.
        moved: (N, 3) world units, where its points went.
        maps: (N, 3, 3) Jacobians of the motion, where the source `has_normals`.

    Returns:
        What is not in the written file, or not turned along; for the user.

    Raises:
        InputError: see `save_points`.
    """
    path = Path(path)
    check_point_path(path)
    array, ply = moved.detach().cpu().numpy(), source.ply
    if path.suffix.lower() == ".ply" and ply is not None and ply.can_be_moved():
        _checked(path, array)
        jacobians = None if maps is None else maps.detach().cpu().numpy()
        write_whole(path, ply.moved(array, jacobians), "points")
        return ply.stays()
    save_points(path, moved, source.colors, source.faces)
    whole = path.suffix.lower() == ".ply"
    return source.not_written(colors=whole and source.colors is not None, faces=whole)


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
    # It takes 30 MB, of which whoever never writes such a file should not know.
    import trimesh
    from trimesh.exchange.gltf import export_glb

    path = Path(path)
    if path.suffix.lower() != ".glb":
        raise InputError(f"{path}: expected a file of points that ends in .glb")
    array = points.detach().cpu().numpy()
    _checked(path, array)
    turned = np.stack([array[:, 0], array[:, 2], -array[:, 1]], axis=1)
    body = trimesh.PointCloud(turned, colors=_paint(path, array, colors))
    write_whole(path, export_glb(trimesh.Scene(body)), "points")


def check_point_path(path: Path) -> None:
    """Raise InputError unless the name ends in .npy or .ply."""
    if path.suffix.lower() not in POINT_SUFFIXES:
        raise InputError(
            f"{path}: expected a file of points that ends in .npy or .ply, "
            f"got {path.suffix or 'no ending'!r}"
        )


def _parse_npy(path: Path, content: bytes) -> NDArray[Any]:
    try:
        # allow_pickle=False: an .npy can carry a pickle, and unpickling runs what is in it.
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except Exception as error:  # a damaged header can make NumPy raise anything
        known = None if content.startswith(b"\x93NUMPY") else kind_of(content)
        raise InputError(
            f"{path}: expected a NumPy array of numbers (pickles are never read), got "
            f"{known or 'a file that is damaged or holds something else'}; write it again with "
            "numpy.save"
        ) from error
    if not isinstance(array, np.ndarray):
        raise InputError(f"{path}: expected one NumPy array (N, 3), got an archive (.npz) of them")
    return cast("NDArray[Any]", array)


def _parse_ply(path: Path, content: bytes) -> PointFile:
    found = read_point_ply(content, str(path))
    positions = _checked(path, found.positions())
    colors, why = found.colors()
    faces = found.triangles()
    if faces is not None:
        check_corners(faces, len(positions), str(path))
    return PointFile(
        positions=positions,
        colors=None if colors is None else torch.from_numpy(colors),
        faces=None if faces is None or not len(faces) else torch.from_numpy(faces),
        ply=found,
        notes=(why,) if why else (),
    )


def check_corners(faces: NDArray[np.int64], vertices: int, where: str) -> None:
    """Raise InputError unless all corners (F, 3) are numbers of vertices."""
    if faces.size and (faces.min() < 0 or faces.max() >= vertices):
        raise InputError(
            f"{where}: expected faces that refer to vertices 0 to {vertices - 1}, "
            f"got {faces.min()} to {faces.max()}"
        )


def _paint(path: Path, array: NDArray[Any], colors: Tensor | None) -> NDArray[np.uint8] | None:
    paint = None if colors is None else colors.detach().cpu().numpy()
    shapes = ((len(array), 3), (len(array), 4))
    if paint is not None and (paint.dtype != np.uint8 or paint.shape not in shapes):
        raise InputError(
            f"{path}: expected colours (N, 3) or (N, 4) uint8 for {len(array)} points, "
            f"got {paint.shape} {paint.dtype}"
        )
    return paint


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
