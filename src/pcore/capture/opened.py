"""One photo opened: its header, its size against that of its camera, its pose, its view."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, replace

import torch
from torch import Tensor

from pcore.capture.photos import Photo
from pcore.data.cut_off import header_of_whole
from pcore.data.image_files import ImageHeader
from pcore.data.images import Crop, ImageCache, ImageSource
from pcore.data.scene import View
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.lens_distortion import LensDistortion

_GRID, _SEEN = 32, 0.1
"""Pixels a side at which lenses are looked at, and the least share of them that must be seen."""
_SMALLEST = 3
"""Pixels along a side of a picture of which anything can be measured."""
_RIGID, _MENDED = 1e-3, 2e-2
"""Rotations off by less are taken as they are; off by less than the second, the nearest one is."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Opened:
    """A photo that is used: its row in the capture, its view, its lens in pixels of the file."""

    row: int
    photo: Photo
    view: View
    lens: LensDistortion
    notes: tuple[str, ...]


class UnusableError(Exception):
    """Why a photo is not used."""


def open_photo(row: int, photo: Photo, factor: int, cache: ImageCache, *, far: bool) -> Opened:
    """View of one photo, with its exact pose where that is far from the origin.

    Raises:
        UnusableError: there is none; says why.
    """
    if photo.path is None:
        raise UnusableError("no file in the folder")
    if photo.size is not None and min(photo.size) < 1:
        raise UnusableError(f"a camera for {photo.size[0]} x {photo.size[1]} pixels")
    pose, notes = _rigid(photo.world_from_camera)
    header = header_of_whole(photo.path)
    if isinstance(header, str):
        raise UnusableError(header)
    upright = _is_upright(photo, header)
    full = header.upright_size if upright else (header.width, header.height)
    if header.orientation != 1:
        how = "are turned by it, as" if upright else "are read as they are stored, as"
        notes += (f"with an EXIF orientation {how} their cameras ask",)
    said = photo.size or full
    lens = photo.lens.scaled(full[0] / said[0], full[1] / said[1])
    _check_lens(lens, full)
    crop = _whole_blocks(full, factor)
    try:
        camera = Camera(
            world_from_camera=pose.float(),
            width=(crop[2] if crop else full[0]) // factor,
            height=(crop[3] if crop else full[1]) // factor,
            fx=lens.fx / factor,
            fy=lens.fy / factor,
            cx=lens.cx / factor,
            cy=lens.cy / factor,
        )
    except InputError as problem:
        raise UnusableError(str(problem)) from problem
    image = ImageSource(
        path=photo.path,
        header=replace(header, has_alpha=True) if photo.mask or photo.clear else header,
        factor=factor,
        cache=cache,
        mask=photo.mask,
        clear=photo.clear,
        upright=upright,
        lens=None if lens.is_straight else lens,
        crop=crop,
    )
    exact = pose if far else None
    view = View(name=photo.name, camera=camera, image=image, exact_pose=exact)
    return Opened(
        row=row,
        photo=replace(photo, world_from_camera=pose),
        view=view,
        lens=lens,
        notes=notes,
    )


def _check_lens(lens: LensDistortion, size: tuple[int, int]) -> None:
    """Refuse numbers that no lens has: hardly a pixel of the straight picture would be seen."""
    if lens.is_straight:
        return
    if not all(map(math.isfinite, astuple(lens))):
        raise UnusableError("a lens with NaN or infinity")
    small = lens.scaled(_GRID / size[0], _GRID / size[1])
    seen = float(small.sources(_GRID, _GRID)[1].float().mean())
    if seen < _SEEN:
        numbers = ", ".join(f"{k} {getattr(lens, k):g}" for k in ("k1", "k2", "k3", "p1", "p2"))
        raise UnusableError(
            f"its lens ({numbers}) bends {100 * (1 - seen):.0f} % of the straight picture out of "
            "sight; are these numbers of another lens model?"
        )


def _rigid(pose: Tensor) -> tuple[Tensor, tuple[str, ...]]:
    """The pose with a rotation that is one; a note where it was mended."""
    if not bool(torch.isfinite(pose).all()):
        raise UnusableError("a pose with NaN or infinity")
    rotation = pose[:3, :3]
    off = float((rotation @ rotation.T - torch.eye(3, dtype=pose.dtype)).abs().max())
    if off <= _RIGID or off > _MENDED:
        return pose, ()  # The camera refuses what is too far off.
    left, _, right = torch.linalg.svd(rotation)
    mended = pose.clone()
    mended[:3, :3] = left @ right
    return mended, ("whose rotations were off by up to 2 % are turned by the nearest rotation",)


def _is_upright(photo: Photo, header: ImageHeader) -> bool:
    """Whether the pixels are turned by the EXIF tag: only where the model's size asks for it.

    COLMAP and what is built on it take pixels as they are stored.
    """
    stored, upright = (header.width, header.height), header.upright_size
    if photo.size is None or _same_shape(stored, photo.size):
        return False
    if _same_shape(upright, photo.size):
        return True
    raise UnusableError(
        f"{stored[0]} x {stored[1]} pixels, and its camera is for {photo.size[0]} x "
        f"{photo.size[1]}, which is another shape"
    )


def _same_shape(size: tuple[int, int], said: tuple[int, int]) -> bool:
    """Whether a picture is a scaled copy, with sides that were rounded to whole pixels."""
    ratio = size[0] * said[1] / (size[1] * said[0])
    return abs(ratio - 1) <= 0.002 + 1.5 / min(*size, *said)


def _whole_blocks(full: tuple[int, int], factor: int) -> Crop | None:
    """The part of a picture that a factor divides; None: all of it."""
    width, height = full[0] // factor * factor, full[1] // factor * factor
    if min(width, height) < _SMALLEST * factor:
        at = f" at factor {factor}" * (factor > 1)
        raise UnusableError(f"{full[0]} x {full[1]} pixels, too small for a photo{at}")
    return None if (width, height) == full else (0, 0, width, height)
