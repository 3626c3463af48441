"""Captures with a `transforms.json`: nerfstudio, instant-ngp, Polycam, Record3D, Luma.

Frames have their own sizes and lenses, images may be missing, and paths are those of another
machine. The strict form of rendered scenes, `transforms_train.json`, is read by `data.blender`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import torch

from pcore.capture.photo_folders import find_named
from pcore.capture.photos import Capture, Photo, RawPoints
from pcore.data.image_files import read_header
from pcore.data.image_paths import Finder, Wanted, is_file
from pcore.data.scene import Skipped
from pcore.data.transform_keys import CLEAR_KEYS
from pcore.data.transforms import PosedFrame, Transforms, read_transforms
from pcore.errors import InputError, SceneError
from pcore.geometry.lens_distortion import LensDistortion
from pcore.geometry.object_region import Region, region_of_box

_NGP_SCALE, _NGP_OFFSET = 0.33, 0.5
"""instant-ngp's own world: coordinates times `scale` plus `offset`, then x, y, z <- y, z, x; these
where the file says nothing else."""
REGION_KEY = "object_region"
"""Our own key: center and radius of the object, in the world of the file."""
_SPLITS = ("train", "val", "test")


def read_transforms_capture(root: Path, path: Path, factor: int) -> Capture:
    """Read a `transforms.json` and find its photos.

    Args:
        root: folder of the capture; nothing outside of it is read.
        path: the file.
        factor: down-scaling that is wished for; `images_N` is taken where it is complete.

    Raises:
        SceneError: a damaged file, a lens that is not read, masks for some photos only.
    """
    transforms = read_transforms(path, capture=True)
    finder = Finder(root=root)
    clear = _clear(transforms.content, f"scene file {path}")
    photos: list[Photo] = []
    skipped: list[Skipped] = []
    for frame, name in zip(transforms.frames, _names(transforms.frames), strict=True):
        try:
            photos.append(replace(_photo(frame, name, finder), clear=clear))
        except _NoMaskError as problem:
            skipped.append(Skipped(name=name, reason=str(problem)))
    _check_masks(transforms)
    photos, shrunk = _shrunk(photos, factor, root)
    return Capture(
        layout="transforms.json",
        where=f"scene file {path}",
        photos=photos,
        sparse=_points(transforms, finder),
        region=_region(transforms.content, f"scene file {path}"),
        splits=_splits(transforms, [photo.name for photo in photos]),
        notes=[*transforms.notes, *finder.notes(path.name), *_moving(photos)],
        skipped=skipped,
        shrunk=shrunk,
    )


def _moving(photos: Sequence[Photo]) -> list[str]:
    """A note about instant-ngp's masks of what moves, whose white pixels it does not learn from."""
    names = [one.path.with_name(f"dynamic_mask_{one.path.stem}.png") for one in photos if one.path]
    there = [path.name for path in names if is_file(path)]
    if not there:
        return []
    return [
        f"masks of what moves, like {there[0]}, are there for {len(there)} photos and not used: "
        "what moves is learned, too"
    ]


def _clear(content: Mapping[str, Any], where: str) -> tuple[float, ...]:
    """Greys that instant-ngp is told to take for background."""
    found: list[float] = []
    for key, grey in CLEAR_KEYS.items():
        value = content.get(key)
        if value not in (True, False, None):
            raise SceneError(f"{where}: expected true or false in {key!r}, got {value!r}; mend it")
        if value:
            found.append(grey)
    return tuple(found)


class _NoMaskError(Exception):
    """A mask is named and not there."""


def _names(frames: Sequence[PosedFrame]) -> list[str]:
    """Paths as they are written; frames without any are refused."""
    for frame in frames:
        if not frame.file_path:
            raise SceneError(f"{frame.where}: 'file_path' is missing; name the frame's image")
    return [str(frame.file_path) for frame in frames]


def _photo(frame: PosedFrame, name: str, finder: Finder) -> Photo:
    path = find_named(finder, Wanted(where=frame.where, key="file_path", path=name))
    mask = None
    if frame.mask_path and path is not None:
        mask = find_named(finder, Wanted(where=frame.where, key="mask_path", path=frame.mask_path))
        if mask is None:
            raise _NoMaskError(f"no mask at {frame.mask_path}")
    size = frame.lens.full_size
    return Photo(
        name=name,
        path=path,
        world_from_camera=frame.world_from_camera,
        lens=_lens(frame, size or _size_of(path)),
        size=size,
        mask=mask,
    )


def _size_of(path: Path | None) -> tuple[int, int]:
    """Size that intrinsics are for where the file does not say: that of the picture."""
    try:
        header = None if path is None else read_header(path)
    except SceneError:
        header = None
    return (1, 1) if header is None else (header.width, header.height)  # It will be skipped.


def _lens(frame: PosedFrame, full: tuple[int, int]) -> LensDistortion:
    try:
        camera = frame.lens.camera(torch.eye(4), full, full, frame.where)
    except InputError as problem:
        raise SceneError(f"{frame.where}: {problem}") from problem
    return LensDistortion(
        fx=camera.focal[0],
        fy=camera.focal[1],
        cx=float(camera.cx),
        cy=float(camera.cy),
        **frame.bend,
    )


def _check_masks(transforms: Transforms) -> None:
    without = [frame for frame in transforms.frames if not frame.mask_path]
    if 0 < len(without) < len(transforms.frames):
        raise SceneError(
            f"scene file {transforms.path}: expected 'mask_path' in every frame or in none, got it "
            f"in {len(transforms.frames) - len(without)} of {len(transforms.frames)}; the first "
            f"without is {without[0].where.split(', ', 1)[-1]}"
        )


def _shrunk(photos: list[Photo], factor: int, root: Path) -> tuple[list[Photo], int]:
    """Photos of the folder `images_N` where it holds all of them."""
    if factor == 1:
        return photos, 1
    small: list[Photo] = []
    for photo in photos:
        if photo.path is None:
            small.append(photo)
            continue
        folder = photo.path.parent
        path = folder.with_name(f"{folder.name}_{factor}") / photo.path.name
        alone = photo.mask or photo.clear or photo.size is None or folder == root.resolve()
        if alone or not path.is_file():
            return photos, 1
        small.append(replace(photo, path=path))
    return small, factor


def _splits(transforms: Transforms, names: Sequence[str]) -> Mapping[str, Sequence[str]] | None:
    """Splits by `train_filenames` and so on; None where the file has none for training."""
    lists = {split: transforms.content.get(f"{split}_filenames") for split in _SPLITS}
    if not isinstance(lists["train"], list):
        return None
    known = {_plain(name): name for name in names}
    found: dict[str, list[str]] = {}
    for split, listed in lists.items():
        if isinstance(listed, list):
            keys = [_plain(str(one)) for one in cast("list[Any]", listed)]
            found[split] = [known[key] for key in keys if key in known]
    return found


def _plain(name: str) -> str:
    return name.replace("\\", "/").removeprefix("./")


def _points(transforms: Transforms, finder: Finder) -> RawPoints | None:
    """Points of `ply_file_path`: they are in the world of the frames (`applied_transform`)."""
    named = transforms.content.get("ply_file_path")
    if not isinstance(named, str) or not named:
        return None
    where = f"scene file {transforms.path}"
    path = find_named(finder, Wanted(where=where, key="ply_file_path", path=named))
    if path is None:
        finder.spelled[f"the points {named} ('ply_file_path') are not there"] += 1
        return None
    # Reading such files takes a package that nothing else here needs.
    from pcore.data.points import read_point_file

    try:
        file = read_point_file(path)
    except InputError as problem:
        raise SceneError(f"{where}: {problem}") from problem
    colors = None if file.colors is None else file.colors[:, :3].float() / 255
    return RawPoints(positions=file.positions.double(), colors=colors)


def _region(content: Mapping[str, Any], where: str) -> Region | None:
    """The box that instant-ngp is told to look into, or the sphere of a corrected copy of ours."""
    if REGION_KEY in content:
        return _own_region(content[REGION_KEY], where)
    given = "aabb" if "aabb" in content else "render_aabb"
    if given not in content or "render_aabb_to_local" in content:
        return None
    try:
        box = torch.tensor(content[given], dtype=torch.float64)
        if given == "render_aabb":
            scale = float(content.get("scale", _NGP_SCALE))
            offset = torch.tensor(content.get("offset", _NGP_OFFSET), dtype=torch.float64)
            box = (box.roll(1, dims=-1) - offset) / scale
        lower, upper = box
        return region_of_box(lower, upper)
    except (TypeError, ValueError, RuntimeError, IndexError, ZeroDivisionError) as problem:
        others = {key: content[key] for key in ("scale", "offset") if key in content}
        raise SceneError(
            f"{where}: expected two corners of a box in {given!r}, in a world of a number 'scale' "
            f"and of 'offset', got {str(content[given])[:80]} in {str(others)[:80]}; mend it or "
            f"remove {given!r}"
        ) from problem


def _own_region(given: Any, where: str) -> Region:
    try:
        center = torch.tensor(given["center"], dtype=torch.float32)
        return Region(center=center, radius=float(given["radius"]))
    except (TypeError, ValueError, RuntimeError, KeyError) as problem:
        raise SceneError(
            f"{where}: expected center and radius in {REGION_KEY!r}, got {str(given)[:80]}; mend "
            "it or remove the key"
        ) from problem
