"""Folders of masks: which of their files belongs to which photo, and writing one.

A mask is for its photo as the file has it, before any lens is undone: white is object. So masks
that other tools made from the photos, and masks that are written here and corrected by hand, are
the same thing.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from pcore.capture.photos import natural_key
from pcore.data.image_paths import ENDINGS
from pcore.data.images import AlphaOfSplit
from pcore.data.pictures import write_mask
from pcore.data.scene import Scene, Split, SplitsOnDemand, View
from pcore.errors import SceneError

_NAMED = 5
_COARSE = 8
"""Pixels between the places where a lens is undone; between them its map is as good as linear."""


@dataclass(frozen=True, kw_only=True)
class MatchedMasks:
    """Masks of photos.

    Attributes:
        files: photo -> its mask.
        note: how they were matched, a sentence.
    """

    files: Mapping[Path, Path]
    note: str


def scene_with_masks(scene: Scene, folder: Path) -> Scene:
    """Return a scene whose photos have the masks of a folder, in all its splits.

    Masks are taken by name (`0001.png` of `0001.jpg`, also `0001.jpg.png`), in the same sub-folders
    where photos in several of them have one name; where no name fits, by order, if there are as
    many as photos.

    Args:
        scene: as it was loaded; its photos' own alpha is kept beside the masks.
        folder: of images; white is object.

    Raises:
        SceneError: no such folder, or photos without a mask.
    """
    splits = {name: scene.split(name) for name in scene.splits}
    photos = list(dict.fromkeys(view.image.path for views in splits.values() for view in views))
    found = match_masks(photos, folder)
    masked: dict[str, Callable[[], Split]] = {}
    for name, views in splits.items():
        alpha = AlphaOfSplit()
        chosen = tuple(_masked(view, found.files[view.image.path], alpha) for view in views)
        alpha.sources = [view.image for view in chosen]
        split = Split(views=chosen, notes=(*scene.notes, found.note))
        masked[name] = partial(_same, split)
    known = replace(scene, views=SplitsOnDemand(masked), masks=folder)
    known.split("train")  # Its notes are told of once it was read.
    return known


def match_masks(photos: Sequence[Path], folder: Path) -> MatchedMasks:
    """Find the mask of every photo in a folder; as `scene_with_masks`."""
    if not folder.is_dir():
        raise SceneError(f"masks {folder}: no such folder; check the path")
    files = _images(folder)
    names: dict[str, list[Path]] = {}
    for file in files:
        for key in {file.stem, Path(file.stem).stem if _is_image(Path(file.stem)) else file.stem}:
            names.setdefault(key, []).append(file)
    fitting = {photo: names[photo.stem] for photo in photos if photo.stem in names}
    files_of = _one_each(fitting)
    if len(files_of) == len(photos):
        return MatchedMasks(
            files=files_of,
            note=f"masks are taken from {folder.name}: {len(photos)} by name; white is object",
        )
    if not fitting and len(files) == len(photos):
        ordered = dict(zip(sorted(photos, key=_by_name), files, strict=True))
        return MatchedMasks(
            files=ordered,
            note=f"masks are taken from {folder.name}: no name is that of a photo, so by order "
            f"({files[0].name} for {min(photos, key=_by_name).name}, ...)",
        )
    missing = [photo for photo in photos if photo not in files_of]
    named = [f"{one.parent.name}/{one.name}" if one in fitting else one.name for one in missing]
    hint = (
        "; several photos have one name: put their masks into sub-folders called like those of the "
        "photos"
    )
    raise SceneError(
        f"masks {folder}: expected a mask for each of {len(photos)} photos, by name, or as many as "
        f"photos, got {len(files)}; without one are {', '.join(named[:_NAMED])}"
        f"{', ...' * (len(missing) > _NAMED)} ({len(missing)} in all)"
        f"{hint * any(photo in fitting for photo in missing)}"
    )


def write_masks(views: Sequence[View], masks: Sequence[Tensor], folder: Path) -> None:
    """Write masks as PNG files named like their photos, in the pixels of the photos' files.

    Where photos in several folders have one name, the masks lie in folders of the same names.

    Args:
        views: of photos.
        masks: (H, W) uint8 of each view's picture, the lens undone; 255 is object.
        folder: made where it is missing.

    Raises:
        SceneError: two photos of one name in one folder.
        OSError: a file cannot be written.
    """
    photos = [view.image.path for view in views]
    names = [f"{photo.stem}.png" for photo in photos]
    if len(set(names)) < len(names):
        above = Path(os.path.commonpath([photo.parent for photo in photos]))
        names = [photo.relative_to(above).with_suffix(".png").as_posix() for photo in photos]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise SceneError(f"masks {folder}: two photos would have the mask {twice}; rename one")
    for view, mask, name in zip(views, masks, names, strict=True):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_mask(folder / name, in_file(view, mask.float() / 255))


def in_file(view: View, mask: Tensor) -> Tensor:
    """A mask (H, W) of a view's picture in the pixels of its photo's file (turned by its tag)."""
    image = view.image
    width, height = image.size
    columns = torch.linspace(0.5, width - 0.5, width // _COARSE + 2, dtype=torch.float64)
    rows = torch.linspace(0.5, height - 0.5, height // _COARSE + 2, dtype=torch.float64)
    places = torch.stack(torch.meshgrid(columns, rows, indexing="xy"), dim=-1)
    if image.lens is not None:
        places = image.lens.straightened(places)
    if image.crop is not None:
        places = places - torch.tensor(image.crop[:2])
    extent = image.factor * torch.tensor([view.camera.width, view.camera.height])
    coarse = (2 * places / extent - 1).float().permute(2, 0, 1)[None]
    grid = F.interpolate(coarse, (height, width), mode="bilinear", align_corners=True)
    found = F.grid_sample(mask[None, None].float(), grid.permute(0, 2, 3, 1), align_corners=False)
    return found[0, 0]


def _same(split: Split) -> Split:
    return split


def _masked(view: View, mask: Path, alpha: AlphaOfSplit) -> View:
    header = replace(view.image.header, has_alpha=True)
    return replace(view, image=replace(view.image, mask=mask, header=header, alpha=alpha))


def _images(folder: Path) -> list[Path]:
    return sorted((path for path in folder.rglob("*") if _is_image(path)), key=_by_name)


def _is_image(path: Path) -> bool:
    # Some systems put a hidden file of their own beside every picture.
    return path.suffix.lower() in ENDINGS and not path.name.startswith(".") and path.is_file()


def _by_name(path: Path) -> tuple[tuple[int, int | str], ...]:
    return natural_key(path.as_posix())


def _one_each(fitting: Mapping[Path, Sequence[Path]]) -> dict[Path, Path]:
    """The mask of each photo that is nearest, unless it is as near or nearer to another photo."""
    wanted: dict[Path, list[Path]] = {}
    for photo, masks in fitting.items():
        nearest = max(masks, key=partial(_alike, photo))
        wanted.setdefault(nearest, []).append(photo)
    found: dict[Path, Path] = {}
    for mask, photos in wanted.items():
        best = max(_alike(photo, mask) for photo in photos)
        nearest = [photo for photo in photos if _alike(photo, mask) == best]
        if len(nearest) == 1:
            found[nearest[0]] = mask
    return found


def _alike(photo: Path, mask: Path) -> tuple[int, bool]:
    """How many folders a photo and a mask have in common, from the inmost, and the whole name."""
    pairs = zip(reversed(photo.parts[:-1]), reversed(mask.parts[:-1]), strict=False)
    same = itertools.takewhile(lambda pair: pair[0] == pair[1], pairs)
    return sum(1 for _ in same), mask.stem == photo.name
