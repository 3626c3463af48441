"""Camera files of NumPy: IDR and NeuS (`cameras_sphere.npz`), LLFF (`poses_bounds.npy`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
import torch
from numpy.typing import NDArray

from pcore.capture.colmap import opengl_pose
from pcore.capture.photos import Capture, Photo, inside, pictures_in
from pcore.errors import SceneError
from pcore.geometry.lens_distortion import LensDistortion
from pcore.geometry.object_region import Region

IDR_FILES = ("cameras_sphere.npz", "cameras.npz")
"""Names of IDR's file, the first that is there; `cameras_linear_init.npz` is a rough guess."""
_SKEW = 2e-3
"""Skew of a pixel grid, as a share of the focal length, that rounding leaves behind."""


def read_idr(root: Path, path: Path, factor: int) -> Capture:
    """Read cameras, photos (`image` or `rgb`) and masks (`mask`) of the layout of IDR and NeuS.

    The world is that of `world_mat`; `scale_mat` says which sphere of it the object is in. Files
    are paired with cameras in the order of their names. Pixel centres of its projections lie at
    whole numbers.

    Raises:
        SceneError: a damaged file or a pickle (never read), other numbers of photos than of cameras
            or masks, skewed pixels.
    """
    del factor
    content = _archive(path)
    count = sum(name.startswith("world_mat_") and "inv" not in name for name in content)
    folder = next(
        (root / name for name in ("image", "rgb", "images") if (root / name).is_dir()), root
    )
    images = _sorted(folder)
    if len(images) != count or not count:
        raise SceneError(
            f"{path}: expected a photo for each of its {count} cameras, got {len(images)} in "
            f"{folder}; they are paired in the order of their names"
        )
    masks, notes = _masks(root, images)
    photos = [
        _idr_photo(
            _matrix(content, f"world_mat_{index}", path),
            root=root,
            image=image,
            mask=masks[index] if masks else None,
            where=f"{path}, camera {index}",
        )
        for index, image in enumerate(images)
    ]
    region = None
    if "scale_mat_0" in content:
        scale = _matrix(content, "scale_mat_0", path)
        finite = bool(np.isfinite(scale).all())
        radius = float(abs(np.linalg.det(scale[:3, :3])) ** (1 / 3)) if finite else np.nan
        if not radius > 0:
            raise SceneError(
                f"{path}: expected 'scale_mat_0' to scale and shift the unit sphere to the object, "
                f"got a radius of {radius:g} around {scale[:3, 3].tolist()}; leave it out, then "
                "masks or the viewing axes tell where the object is"
            )
        region = Region(center=torch.from_numpy(scale[:3, 3]).float(), radius=radius)
    return Capture(layout="IDR / NeuS", where=str(path), photos=photos, region=region, notes=notes)


def read_llff(root: Path, path: Path, factor: int) -> Capture:
    """Read `poses_bounds.npy`; photos are paired with its rows in the order of their names.

    Raises:
        SceneError: a damaged file or a pickle, another shape, other numbers of photos than of rows.
    """
    try:
        with path.open("rb") as file:
            rows = np.asarray(np.load(file, allow_pickle=False), dtype=np.float64)
    except Exception as problem:  # Damaged headers make NumPy raise anything.
        raise SceneError(_not_numpy(path, problem)) from problem
    if rows.ndim != 2 or rows.shape[1] != 17:
        raise SceneError(
            f"{path}: expected rows of 17 numbers (LLFF's poses_bounds), got shape {rows.shape}"
        )
    small = root / f"images_{factor}"
    shrunk = factor if factor > 1 and small.is_dir() else 1
    choices = [small] if shrunk > 1 else [root / f"images{end}" for end in ("", "_4", "_8")]
    folder = next((one for one in choices if one.is_dir()), root)
    images = _sorted(folder)
    if len(images) != len(rows):
        raise SceneError(
            f"{path}: expected a photo for each of its {len(rows)} poses, got {len(images)} in "
            f"{folder}; they are paired in the order of their names"
        )
    photos: list[Photo] = []
    for row, image in zip(rows, images, strict=True):
        numbers = row[:15].reshape(3, 5)
        height, width, focal = (float(one) for one in numbers[:, 4])
        pose = np.eye(4)
        # Its columns point down, right and backwards.
        pose[:3] = np.stack([numbers[:, 1], -numbers[:, 0], numbers[:, 2], numbers[:, 3]], axis=1)
        sound = np.isfinite([height, width, focal]).all() and min(height, width, focal) > 0
        if not sound:
            raise SceneError(
                f"{path}: expected a size and a focal length for {image.name}, got {width} x "
                f"{height} and {focal}"
            )
        photos.append(
            Photo(
                name=image.name,
                path=inside(root, image),
                world_from_camera=torch.from_numpy(pose),
                lens=LensDistortion(fx=focal, fy=focal, cx=width / 2, cy=height / 2),
                size=(round(width), round(height)),
            )
        )
    return Capture(layout="LLFF", where=str(path), photos=photos, shrunk=shrunk)


def decompose(projection: NDArray[np.float64]) -> tuple[NDArray[np.float64], torch.Tensor]:
    """Intrinsics (3, 3), with 1 at the end, and OpenGL pose (4, 4) of a projection (3, 4)."""
    square = projection[:, :3]
    if np.linalg.det(square) < 0:
        projection, square = -projection, -square
    intrinsics, rotation = scipy.linalg.rq(square)
    signs = np.sign(np.diag(intrinsics))
    intrinsics, rotation = intrinsics * signs, signs[:, None] * rotation
    translation = np.linalg.solve(intrinsics, projection[:, 3])
    return intrinsics / intrinsics[2, 2], opengl_pose(rotation, translation)


def _idr_photo(
    world: NDArray[np.float64], *, root: Path, image: Path, mask: Path | None, where: str
) -> Photo:
    unknown = not np.isfinite(world).all() or abs(np.linalg.det(world[:3, :3])) < 1e-12
    if unknown:  # The photo is skipped for its pose.
        nothing = torch.full((4, 4), torch.nan, dtype=torch.float64)
        lens = LensDistortion(fx=1, fy=1, cx=0, cy=0)
        return Photo(name=image.name, path=image, world_from_camera=nothing, lens=lens)
    intrinsics, pose = decompose(world[:3])
    if abs(intrinsics[0, 1]) > _SKEW * intrinsics[0, 0]:
        raise SceneError(
            f"{where}: expected pixels without skew, got {intrinsics[0, 1]:.3g} beside a focal "
            f"length of {intrinsics[0, 0]:.6g} pixels; is the matrix a projection to pixels?"
        )
    lens = LensDistortion(
        fx=float(intrinsics[0, 0]),
        fy=float(intrinsics[1, 1]),
        cx=float(intrinsics[0, 2]) + 0.5,
        cy=float(intrinsics[1, 2]) + 0.5,
    )
    return Photo(
        name=image.name,
        path=inside(root, image),
        world_from_camera=pose,
        lens=lens,
        mask=None if mask is None else inside(root, mask),
    )


def _masks(root: Path, images: list[Path]) -> tuple[list[Path], list[str]]:
    masks = next((found for name in ("mask", "masks") if (found := _sorted(root / name))), [])
    if not masks:
        return [], []
    if len(masks) != len(images):
        raise SceneError(
            f"{masks[0].parent}: expected a mask for each of {len(images)} photos, got "
            f"{len(masks)}; they are paired in the order of their names"
        )
    if [one.stem for one in masks] == [one.stem for one in images]:
        return masks, []
    return masks, [
        f"masks are paired with photos in the order of their names: {masks[0].name} is that of "
        f"{images[0].name}"
    ]


def _sorted(folder: Path) -> list[Path]:
    """Pictures in the order of letters, as those layouts were written."""
    return sorted(pictures_in(folder), key=lambda path: path.name)


def _archive(path: Path) -> Mapping[str, NDArray[Any]]:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return {
                name: archive[name]
                for name in archive.files
                if name.startswith(("world_mat_", "scale_mat_"))
            }
    except Exception as problem:  # Damaged archives make NumPy and zipfile raise anything.
        raise SceneError(_not_numpy(path, problem)) from problem


def _not_numpy(path: Path, problem: Exception) -> str:
    return (
        f"{path}: expected numbers of NumPy (pickles are never read), got a file that is damaged "
        f"or holds something else ({str(problem)[:80]}); copy it again"
    )


def _matrix(content: Mapping[str, NDArray[Any]], name: str, path: Path) -> NDArray[np.float64]:
    found = content.get(name)
    if found is None or found.shape != (4, 4) or found.dtype.kind not in "fiu":
        got = "nothing" if found is None else f"shape {found.shape} of type {found.dtype}"
        raise SceneError(f"{path}: expected a 4 x 4 matrix {name!r}, got {got}")
    return found.astype(np.float64)
