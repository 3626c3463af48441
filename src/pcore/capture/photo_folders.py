"""The folder of the photos that a layout names, and masks beside them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PureWindowsPath

from pcore.capture.photos import Photo, inside
from pcore.data.image_paths import Finder, Wanted, is_file, mask_places
from pcore.errors import SceneError

_ABSOLUTE = re.compile(r"^([A-Za-z]:[\\/]|[\\/])")


@dataclass(frozen=True, kw_only=True)
class PhotoFolder:
    """Photos of a list of names.

    Attributes:
        paths: files in the order of the names; None where there is none.
        shrunk: whole number by which they are smaller than the originals.
        notes: in what they differ from what is named, a sentence each.
    """

    paths: tuple[Path | None, ...]
    shrunk: int = 1
    notes: tuple[str, ...] = ()


def find_photos(
    root: Path, names: Sequence[str], folders: Sequence[str], factor: int, where: str
) -> PhotoFolder:
    """Find the folder that has the photos of a list of names.

    Args:
        root: folder of the capture.
        names: paths below the folder of photos, as files write them.
        folders: where photos may lie, below the root; the one with the most of them is taken.
        factor: down-scaling that is wished for; a copy of the first folder that is as much smaller
            (`images_4`) goes before it, as Mip-NeRF 360 and nerfstudio name them.
        where: the file of the names, for messages.

    Raises:
        SceneError: no photo at all, or one that lies outside of the root.
    """
    main = folders[0]
    places = [(folder, 1) for folder in folders]
    if factor > 1 and (root / f"{main}_{factor}").is_dir():
        places.insert(0, (f"{main}_{factor}", factor))
    # Data sets are passed on with their small copies alone: the largest of them then stands in.
    copies = [(f"{main}_{n}", 1) for n in (2, 4, 8) if (root / f"{main}_{n}").is_dir()]
    best = PhotoFolder(paths=(None,) * len(names))
    most = 0
    for folder, shrunk in [*places, *copies]:
        finder = Finder(root=root)
        paths = tuple(_find(finder, folder, name, where) for name in names)
        found = sum(path is not None for path in paths)
        if found > most:
            most = found
            notes = finder.notes(where)
            if (folder, shrunk) in copies or shrunk > 1:
                notes += (f"the photos of {folder} are used; intrinsics are scaled to them",)
            best = PhotoFolder(paths=paths, shrunk=shrunk, notes=notes)
        if found == len(names):
            break
    if not most:
        raise SceneError(
            f"{where}: names {len(names)} photos, of which none is in {root} (looked in "
            f"{', '.join(folder for folder, _ in places)}); put them into the folder {main}; the "
            f"first is {names[0]!r}"
        )
    return best


def _find(finder: Finder, folder: str, name: str, where: str) -> Path | None:
    """A photo by its path below the folder, or by its name alone (3DGS drops sub-folders)."""
    if not (finder.root / folder).is_dir():
        return None
    for path in dict.fromkeys((name, PureWindowsPath(name).name)):
        wanted = Wanted(where=f"{where} ({name})", key="name", path=f"{folder}/{path}")
        found = finder.find(wanted)
        if found is not None:
            return found
    return None


def find_named(finder: Finder, wanted: Wanted) -> Path | None:
    """A file that a capture names; absolute paths of another machine are taken by their ends."""
    if not _ABSOLUTE.match(wanted.path):
        return finder.find(wanted)
    given = Path(wanted.path)
    if given.is_absolute() and given.resolve().is_relative_to(finder.root.resolve()):
        return finder.find(wanted)
    parts = [part for part in re.split(r"[\\/]", wanted.path) if part not in ("", "..")]
    for start in range(1, len(parts)):
        end = replace(wanted, path="/".join(parts[start:]))
        found = finder.find(end)
        if found is not None:
            finder.spelled["absolute paths are read from the scene's folder on"] += 1
            return found
    return None


def with_masks(photos: Sequence[Photo], root: Path) -> tuple[Sequence[Photo], tuple[str, ...]]:
    """Photos with the masks that lie beside them, if all have one; a note about what was found.

    Looked for are `masks/NAME.png`, `mask/NAME.png` and, beside the photo, `NAME.alpha.png` (NAME
    with or without the photo's ending). White is object. A mask that fits several photos is none.
    """
    if any(photo.mask is not None for photo in photos):
        return photos, ()
    there = [photo for photo in photos if photo.path is not None]
    found = {photo.name: mask for photo in there if (mask := _mask_beside(photo, root))}
    if not found:
        return photos, ()
    example = next(iter(found.values())).relative_to(root.resolve()).as_posix()
    owners: dict[Path, set[Path | None]] = {}
    for photo in there:
        if photo.name in found:
            owners.setdefault(found[photo.name], set()).add(photo.path)
    shared = sum(len(paths) for paths in owners.values() if len(paths) > 1)
    if shared or len(found) < len(there):
        hint = (
            f"{shared} photos share theirs with one of another folder, so put masks into the same "
            "sub-folders"
            if shared
            else "give one for every photo"
        )
        return photos, (
            f"masks like {example} are there for {len(found)} of {len(there)} photos and not used; "
            f"{hint}",
        )
    masked = [replace(photo, mask=found.get(photo.name)) for photo in photos]
    return masked, (f"masks beside the photos are used, like {example}: white is object",)


def _mask_beside(photo: Photo, root: Path) -> Path | None:
    assert photo.path is not None, "photos without a file have no mask"
    below = Path(photo.name.replace("\\", "/")).parent
    plain = not below.is_absolute() and ".." not in below.parts
    names = (photo.path.stem, photo.path.name)
    candidates = [
        *(mask_places(root, photo.path, below) if plain else []),
        *mask_places(root, photo.path),
        *(photo.path.with_name(f"{name}.alpha{photo.path.suffix}") for name in names),
    ]
    path = next((path for path in candidates if is_file(path)), None)
    return None if path is None else inside(root, path)
