"""Posed photos as every layout hands them over, before any picture is opened."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor

from pcore.data.image_paths import ENDINGS, resolved_link
from pcore.data.scene import Skipped
from pcore.errors import SceneError
from pcore.geometry.lens_distortion import LensDistortion
from pcore.geometry.object_region import Region

VIDEOS = (".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm")
HELD_OUT = 8
"""Every so many views, by name, are for tests where a layout has no splits (Mip-NeRF 360)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Photo:
    """One photo with its pose and lens.

    Attributes:
        name: as the capture's files write it, unique among them.
        path: the file, or None where there is none.
        world_from_camera: (4, 4) float64, OpenGL axes.
        lens: intrinsics and distortion in pixels of `size`, pixel centres at .5.
        size: (width, height) that `lens` belongs to; None: that of the file.
        mask: file of its mask; None where none is named.
        clear: greys in [0, 1] that are background where a pixel has exactly one of them.
    """

    name: str
    path: Path | None
    world_from_camera: Tensor
    lens: LensDistortion
    size: tuple[int, int] | None = None
    mask: Path | None = None
    clear: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class RawPoints:
    """Sparse points with places in the photos as a reconstruction writes them.

    Attributes:
        positions: (N, 3) float64 world units.
        colors: (N, 3) float32 in [0, 1], or None.
        errors: (N,) float32 pixels, or None.
        points: (M,) int64 row of the point of each sighting; None where there are no sightings.
        photos: (M,) int64 which photo sees it, by the order of `Capture.photos`.
        places: (M, 2) float64 column and row in pixels of `Photo.size`, distorted.
    """

    positions: Tensor
    colors: Tensor | None = None
    errors: Tensor | None = None
    points: Tensor | None = None
    photos: Tensor | None = None
    places: Tensor | None = None

    @property
    def seen_by(self) -> Tensor | None:
        """(N,) int64 number of photos that each is found in; None without sightings."""
        if self.points is None or self.photos is None:
            return None
        pairs = torch.stack([self.points, self.photos], dim=1).unique(dim=0)
        return torch.bincount(pairs[:, 0], minlength=len(self.positions))


@dataclass(frozen=True, kw_only=True, eq=False)
class Capture:
    """What the files of a layout say.

    Attributes:
        layout: its name.
        where: the file of the cameras, the start of messages.
        photos: in the order of the files; those without a file are skipped later.
        sparse: points of the reconstruction.
        region: where the object is said to be.
        splits: names of photos by split; None: every eighth is for tests.
        notes: what is odd, a sentence each.
        skipped: photos that could not even be listed.
        shrunk: whole number by which the files are smaller than the originals already.
    """

    layout: str
    where: str
    photos: Sequence[Photo]
    sparse: RawPoints | None = None
    region: Region | None = None
    splits: Mapping[str, Sequence[str]] | None = None
    notes: Sequence[str] = field(default_factory=tuple[str, ...])
    skipped: Sequence[Skipped] = field(default_factory=tuple[Skipped, ...])
    shrunk: int = 1


def natural_key(name: str) -> tuple[tuple[int, int | str], ...]:
    """Key that sorts numbers inside of names by value: img_2 before img_10."""
    parts = re.split(r"(\d+)", name.casefold())
    return tuple((0, int(one)) if one.isdecimal() else (1, one) for one in parts if one)


def pictures_in(folder: Path) -> list[Path]:
    """Pictures right in a folder, in natural order; hidden files are none."""
    if not folder.is_dir():
        return []
    found = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in ENDINGS and not path.name.startswith(".") and path.is_file()
    ]
    return sorted(found, key=lambda path: natural_key(path.name))


def photos_below(folder: Path) -> list[Path]:
    """Pictures right in a folder; where there are none, those in its sub-folders, folder by folder.

    Folders of masks and depth are none of photos. Two pictures of one name but for the ending are
    one photo that was saved twice, or its mask: the first is taken.
    """
    found = pictures_in(folder)
    if not found and folder.is_dir():
        below = sorted(
            (one for one in folder.iterdir() if one.is_dir() and not _is_other(one.name)),
            key=lambda one: natural_key(one.name),
        )
        found = [picture for one in below for picture in pictures_in(one)]
    first: dict[Path, Path] = {}
    for path in found:
        first.setdefault(path.with_suffix(""), path)
    return list(first.values())


def _is_other(name: str) -> bool:
    """Whether a sub-folder is hidden, of what is no photo, or of a scene whose poses are lost."""
    return name.startswith((".", "mask", "depth", "normal")) or name in ("train", "val", "test")


def inside(root: Path, path: Path) -> Path:
    """Return a file resolved, if it lies in a folder; symbolic links may lead out of it.

    Raises:
        SceneError: it lies elsewhere, or links lead in a circle.
    """
    resolved = resolved_link(path)
    if not resolved.is_relative_to(root.resolve()):
        raise SceneError(
            f"{path}: leads out of the scene's folder {root} (to {resolved}); scenes may only read "
            "their own files: copy it into the folder"
        )
    return resolved
