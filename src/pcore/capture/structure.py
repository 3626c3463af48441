"""Poses for photos and videos that have none: structure from motion by COLMAP, in a child process.

The child is another Python: COLMAP's library and Pillow crash one another in one process, and one
that hangs can be ended. Models, and frames of videos, are kept in the user's cache.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import shutil
import struct
import sys
import tempfile
from collections.abc import Hashable, Sequence
from pathlib import Path

from PIL import ExifTags, Image, ImageOps

from pcore.capture.colmap import find_model
from pcore.capture.colmap_child import Patience, Tell, run_child
from pcore.capture.layouts import PHOTOS, Layout
from pcore.capture.photos import inside, photos_below
from pcore.capture.video_frames import choose_frames
from pcore.data.cut_off import why_unreadable
from pcore.data.image_files import read_header
from pcore.errors import DependencyError, SceneError

CHILD = (sys.executable, "-m", "pcore.capture.structure_child")
_LEAST = 3
_NOT_COLMAP = (".webp", ".avif", ".heic", ".heif")
"""Pictures that Pillow reads, with its plug-in, and COLMAP does not."""
_WORLD = "-upright"
"""Which world models are in; older ones stay as COLMAP left them, for what was trained on them."""
_QUALITY = 95
_DAMAGED = (SyntaxError, TypeError, ValueError, KeyError, struct.error)
"""What Pillow raises for EXIF that is not."""
_NOTE = "video.txt"
"""What was left out of a video, beside its frames."""


def with_poses(layout: Layout, tell: Tell, patience: Patience | None = None) -> Layout:
    """Pose photos, or frames of a video; the same files are posed once.

    Returns:
        The layout of the model in the cache, with the photos where they are.

    Raises:
        SceneError: too few photos, a link that leads out of the folder, no common structure, or a
            child that hung or crashed.
        DependencyError: pycolmap (extra `colmap`) is not installed.
    """
    video = layout.name != PHOTOS
    sources = [layout.path] if video else photos_below(layout.path)
    for path in sources:
        inside(layout.root, path)  # Before COLMAP reads what links lead to.
    place = _place(sources)
    if not place.is_dir():
        if importlib.util.find_spec("pycolmap") is None:
            raise DependencyError(
                f"scene {layout.root}: holds photos without poses; finding them needs pycolmap, "
                "which is not installed: `pip install 'pcore-edit[colmap]'`, or pose the photos "
                "with COLMAP and put its model into sparse/0"
            )
        if not video and len(sources) < _LEAST:
            raise SceneError(
                f"scene {layout.root}: expected at least {_LEAST} photos to find poses for, got "
                f"{len(sources)}"
            )
        if layout.note:
            tell(layout.note)
        _reconstruct(layout, place, tell, patience or Patience())
    found = find_model(place)
    if found is None:
        raise SceneError(f"{place}: expected the model of {layout.path}; remove this folder")
    root = place if video else layout.root
    notes = [layout.note, found.note]
    if (place / _NOTE).is_file():
        notes.append((place / _NOTE).read_text(encoding="utf-8"))
    note = "; ".join(note for note in notes if note)
    return Layout(name="COLMAP", root=root, path=found.folder, note=note)


def is_posed(layout: Layout) -> bool:
    """Whether `with_poses` has posed these photos or this video before."""
    sources = [layout.path] if layout.name != PHOTOS else photos_below(layout.path)
    return _place(sources).is_dir()


def _place(sources: Sequence[Path]) -> Path:
    """Where the model of these files is kept."""
    older = cache_folder() / files_key(sources)
    return older if older.is_dir() else older.with_name(f"{older.name}{_WORLD}")


def cache_folder() -> Path:
    """Where models and frames are kept: $XDG_CACHE_HOME or ~/.cache, then pcore/structure."""
    cache = os.environ.get("XDG_CACHE_HOME")
    return (Path(cache) if cache else Path.home() / ".cache") / "pcore" / "structure"


def files_key(sources: Sequence[Path]) -> str:
    """Name of the same files: their places, sizes and times."""
    digest = hashlib.sha256()
    for path in sources:
        state = path.stat()
        digest.update(f"{path.resolve()}\0{state.st_size}\0{state.st_mtime_ns}\n".encode())
    return digest.hexdigest()[:24]


def _reconstruct(layout: Layout, place: Path, tell: Tell, patience: Patience) -> None:
    """Make the model in a folder beside its place and move it there when it is whole."""
    place.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=place.parent, prefix="unfinished-") as made:
        work = Path(made)
        images = layout.path
        if layout.name != PHOTOS:
            images = work / "images"
            note = choose_frames(layout.path, images, tell)
            (work / _NOTE).write_text(note, encoding="utf-8")
        whole = [path for path in photos_below(images) if why_unreadable(path) is None]
        cameras = [whole] if layout.name != PHOTOS else _by_camera(whole)
        images, names = _readable(images, whole, work / "converted")
        wish = {
            "images": str(images.resolve()),
            "cameras": [[names[path] for path in group] for group in cameras],
            "output": str(work / "sparse"),
            "database": str(work / "database.db"),
            "ordered": layout.name != PHOTOS,
        }
        run_child([*CHILD, json.dumps(wish)], tell, patience, str(layout.path), "poses")
        (work / "database.db").unlink(missing_ok=True)
        shutil.rmtree(work / "converted", ignore_errors=True)
        model = find_model(work)
        if model is None:
            raise SceneError(
                f"scene {layout.path}: COLMAP found no common structure in {len(names)} photos; "
                "take them closer together, sharp, with texture around the object. Behind a "
                "turntable the room stands still: walk around the object instead, or hang plain "
                "cloth behind"
            )
        shutil.copytree(work, place)


def _by_camera(photos: Sequence[Path]) -> list[list[Path]]:
    """Photos of one folder, size, device and focal length, which share a lens."""
    groups: dict[Hashable, list[Path]] = {}
    for path in photos:
        with Image.open(path) as image:
            turned = _is_turned(path)
            groups.setdefault((path.parent, image.size, turned, _device(image)), []).append(path)
    return list(groups.values())


def _is_turned(path: Path) -> bool:
    """Whether a tag turns a photo by a quarter, which the shape of its camera can then tell."""
    header = read_header(path)
    return header.upright_size != (header.width, header.height)


def _save_upright(image: Image.Image, copy: Path, *, turn: bool) -> None:
    """Save a photo as COLMAP reads it; the focal length in EXIF is where that begins."""
    try:
        upright = ImageOps.exif_transpose(image) if turn else image
        upright.convert("RGB").save(copy, quality=_QUALITY, exif=upright.getexif())
    except _DAMAGED:  # Its EXIF: then without a focal length, and as it is stored.
        image.convert("RGB").save(copy, quality=_QUALITY)


def _device(image: Image.Image) -> tuple[str, ...] | None:
    """Maker, model and focal length as EXIF has them; None without, or where that is damaged."""
    try:
        # Not image.getexif(): that of a PNG file decodes all of it.
        exif = Image.Image.getexif(image)
        inner = exif.get_ifd(ExifTags.IFD.Exif)
    except (OSError, *_DAMAGED):
        return None
    said = exif.get(ExifTags.Base.Make), exif.get(ExifTags.Base.Model)
    found = (*said, inner.get(ExifTags.Base.FocalLength))
    return None if found == (None, None, None) else tuple(map(str, found))


def _readable(images: Path, whole: Sequence[Path], converted: Path) -> tuple[Path, dict[Path, str]]:
    """Folder of photos as COLMAP reads them, and the name of each in it.

    Where it does not read a format, or would take a portrait for a landscape, all are copied: those
    converted, the others as they are.
    """
    foreign = {path for path in whole if path.suffix.lower() in _NOT_COLMAP}
    turned = {path for path in whole if _is_turned(path)}
    if not foreign | turned:
        return images, {path: path.relative_to(images).as_posix() for path in whole}
    names: dict[Path, str] = {}
    for path in whole:
        copy = converted / path.relative_to(images)
        copy.parent.mkdir(parents=True, exist_ok=True)
        if path in foreign:
            copy = copy.with_suffix(".png")
        if path in foreign | turned:
            with Image.open(path) as image:
                _save_upright(image, copy, turn=path in turned)
        else:
            shutil.copyfile(path, copy)
        names[path] = copy.relative_to(converted).as_posix()
    return converted, names
