"""The NeRF-Synthetic ("Blender") format: `transforms_{train,val,test}.json` and images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch

from pcore.data.image_files import ImageHeader, read_header
from pcore.data.image_paths import Finder, Wanted, is_file, mask_places
from pcore.data.images import AlphaOfSplit, ImageCache, ImageSource, check_factor
from pcore.data.poses import are_far, check_poses
from pcore.data.scene import Split, SplitsOnDemand, View
from pcore.data.transforms import PosedFrame, Transforms, read_transforms
from pcore.errors import SceneError

SPLITS = ("train", "val", "test")


def transforms_path(root: Path, split: str) -> Path:
    """Where the format keeps the cameras of a split."""
    return root / f"transforms_{split}.json"


@dataclass(frozen=True, kw_only=True)
class SplitFile:
    """Where the views of one split are written.

    Attributes:
        root: folder that paths of images start from; images must lie inside it.
        path: the transforms file.
        time: only frames of this time stamp belong to it (`same_time`); None: all.
    """

    root: Path
    path: Path
    time: float | None = None


def splits_in(root: Path, time: float | None = None) -> dict[str, SplitFile]:
    """Splits of the format that are in a folder, in the order train, val, test."""
    paths = {split: transforms_path(root, split) for split in SPLITS}
    return {
        split: SplitFile(root=root, path=path, time=time)
        for split, path in paths.items()
        if path.is_file()
    }


def same_time(first: float | None, second: float | None) -> bool:
    """Whether two time stamps are one: they agree in six digits, as their names do."""
    return first is not None and second is not None and f"{first:.6g}" == f"{second:.6g}"


def load_splits(
    files: Mapping[str, SplitFile], *, factor: int, cache: ImageCache, note: str = ""
) -> SplitsOnDemand:
    """Splits by their files; each is read when it is needed, and has the note beside its own.

    Then the headers of all its images are read, so that a missing file or a wrong size is found
    at once and not in the middle of training; pixels are decoded later.
    """
    return SplitsOnDemand(
        {
            split: partial(load_split, split, file, factor=factor, cache=cache, note=note)
            for split, file in files.items()
        }
    )


def load_split(
    split: str, file: SplitFile, *, factor: int, cache: ImageCache, note: str = ""
) -> Split:
    """Views of one split, and what is odd about its files.

    Args:
        split: "train", "val" or "test". The poses of training views must be those of one object.
        file: where it is written.
        factor: whole number by which images are down-scaled.
        cache: keeps decoded images.
        note: what is to be said of the files before what is odd about them.

    Raises:
        SceneError: files missing, damaged or inconsistent.
        InputError: a factor that does not divide the image size.
    """
    root, transforms = file.root, read_transforms(file.path)
    if file.time is not None:
        chosen = [frame for frame in transforms.frames if same_time(frame.time, file.time)]
        transforms = replace(transforms, frames=tuple(chosen))
    frames = transforms.frames
    finder = Finder(root=root)
    images = finder.find_all(_wanted(frames))
    masks = _masks(frames, finder, transforms.path)
    alpha = AlphaOfSplit()
    far = are_far([frame.world_from_camera for frame in frames])
    views: list[View] = []
    first: tuple[int, int] | None = None
    turned = 0
    for frame, path, mask in zip(frames, images, masks, strict=True):
        header = read_header(path)
        upright = _is_upright(frame, header)
        turned += upright
        full = header.upright_size if upright else (header.width, header.height)
        _check_size(frame, full, first)
        first = first or full
        check_factor(*full, factor)
        source = ImageSource(
            path=path,
            header=header if mask is None else replace(header, has_alpha=True),
            factor=factor,
            cache=cache,
            mask=mask,
            upright=upright,
            alpha=alpha,
        )
        camera = transforms.camera(frame, (full[0] // factor, full[1] // factor), full)
        exact = frame.world_from_camera if far else None
        views.append(View(name=frame.name, camera=camera, image=source, exact_pose=exact))
    alpha.sources = [view.image for view in views]
    notes = [note, *transforms.notes, *finder.notes(transforms.path.name)]
    notes += _notes(views, turned, root)
    if split == "train":
        notes.append(_check_poses(transforms, views))
    return Split(views=tuple(views), notes=tuple(note for note in notes if note))


def _wanted(frames: Sequence[PosedFrame]) -> list[Wanted]:
    wanted: list[Wanted] = []
    for frame in frames:
        if not frame.file_path:
            raise SceneError(f"{frame.where}: 'file_path' is missing; name the frame's image")
        wanted.append(Wanted(where=frame.where, key="file_path", path=frame.file_path))
    return wanted


def _masks(frames: Sequence[PosedFrame], finder: Finder, path: Path) -> Sequence[Path | None]:
    """Files of the masks, all or none."""
    wanted = [
        Wanted(where=frame.where, key="mask_path", path=frame.mask_path)
        for frame in frames
        if frame.mask_path
    ]
    if not wanted:
        return [None] * len(frames)
    if len(wanted) < len(frames):
        without = next(frame.where for frame in frames if not frame.mask_path)
        raise SceneError(
            f"scene file {path}: expected 'mask_path' in every frame or in none, got it in "
            f"{len(wanted)} of {len(frames)}; the first without is {without.split(', ', 1)[-1]}"
        )
    return finder.find_all(wanted)


def _is_upright(frame: PosedFrame, header: ImageHeader) -> bool:
    """Whether cameras are for the image as viewers turn it, by its EXIF tag.

    COLMAP takes pixels as they are stored, phones and most viewers turn them: only the size in
    the scene file can tell which of them is meant.
    """
    if header.orientation == 1:
        return False
    stored, upright = (header.width, header.height), header.upright_size
    said = frame.lens.full_size
    if said in (stored, upright) and stored != upright:
        return said == upright
    means = (
        f"{upright[0]} x {upright[1]} as viewers show it, {stored[0]} x {stored[1]} as it is stored"
    )
    how = (
        f"add 'w' and 'h' of what the cameras are for to the scene file ({means}), or write"
        if stored != upright and said is None
        else "write"
    )
    raise SceneError(
        f"{frame.where}: the image is turned by its EXIF tag (orientation {header.orientation}), "
        f"and the scene file does not tell whether its cameras are for the turned image; {how} the "
        "images without the tag: `mogrify -auto-orient` turns the pixels, `exiftool -Orientation=` "
        "leaves them as they are stored (as COLMAP takes them)"
    )


def _check_size(frame: PosedFrame, size: tuple[int, int], first: tuple[int, int] | None) -> None:
    said = frame.lens.full_size
    for expected, source in ((said, "'w' and 'h' of the file"), (first, "the first image")):
        if expected is not None and size != expected:
            raise SceneError(
                f"{frame.where}: expected an image of {expected[0]} x {expected[1]} pixels like "
                f"{source}, got {size[0]} x {size[1]}; resize it or mend the scene file"
            )


def _notes(views: Sequence[View], turned: int, root: Path) -> list[str]:
    """What is odd about the images, a sentence each."""
    notes: list[str] = []
    if turned:
        notes.append(
            f"{turned} of {len(views)} images are turned by their EXIF tag, as 'w' and 'h' say"
        )
    if not any(view.image.header.has_alpha for view in views):
        beside = _mask_beside(views[0].image.path, root)
        if beside is not None:
            notes.append(
                f"{beside.relative_to(root.resolve()).as_posix()} looks like a mask and is not "
                "used: name it by 'mask_path' in its frame (white is object)"
            )
    return notes


def _mask_beside(image: Path, root: Path) -> Path | None:
    """A mask of an image where instant-ngp, nerfstudio and COLMAP keep one; None if none is."""
    name, stem, folder = image.name, image.stem, image.parent
    candidates = [
        folder / f"dynamic_mask_{stem}.png",
        folder / f"{name}.alpha{image.suffix}",
        folder / f"{stem}.alpha{image.suffix}",
        *mask_places(root.resolve(), image),
    ]
    # An image's name may fit its system, and a longer one beside it not.
    return next((path for path in candidates if is_file(path)), None)


def _check_poses(transforms: Transforms, views: Sequence[View]) -> str:
    poses = torch.stack([frame.world_from_camera for frame in transforms.frames])
    return check_poses(
        poses,
        [view.camera for view in views],
        [view.name for view in views],
        f"scene file {transforms.path}",
    )
