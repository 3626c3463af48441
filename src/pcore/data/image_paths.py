"""Images of a scene by the names that its file gives them, as other systems spell them.

A name is taken as it is written when there is such a file. Else backslashes count as slashes, and
letters in the other case, in another Unicode normal form (macOS decomposes them) and another ending
of image files are the same name, if only one file has it.
"""

from __future__ import annotations

import os
import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath, PureWindowsPath

from pcore.errors import SceneError

ENDINGS = (
    *(".png", ".jpg", ".jpeg", ".jfif", ".webp", ".bmp", ".tif", ".tiff"),
    *(".heic", ".heif", ".avif"),
)
"""Of pictures, in lower case: what names may end in, and what is looked for in a folder."""
_Listing = dict[str, list[Path]]
_NAMED = 20
"""Missing files that a message names; it says the number of all."""
_LONGEST_NAME, _LONGEST_PATH = 250, 1000
_SEARCHED = 20_000
"""Files of a folder that are looked through for one of the same name."""


_MASK_ENDINGS = (".png", ".PNG", ".jpg", ".JPG", ".jpeg", ".webp")


def mask_places(home: Path, image: Path, below: Path = Path()) -> list[Path]:
    """Where folders of masks may have that of an image, the first first.

    Args:
        home: folder that holds them.
        image: whose mask it is.
        below: where in the folder of masks it lies.
    """
    return [
        home / kind / below / f"{file}{ending}"
        for kind in ("masks", "mask")
        for ending in _MASK_ENDINGS
        for file in (image.stem, image.name)
    ]


def resolved_link(path: Path) -> Path:
    """Return where symbolic links lead; SceneError where that is a circle."""
    try:
        return path.resolve()
    except (OSError, RuntimeError) as error:  # RuntimeError: Python before 3.13.
        raise SceneError(f"{path}: a symbolic link that leads in a circle; remove it") from error


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """A file that a frame names.

    Attributes:
        where: file and frame, the start of every message about it.
        key: of the frame, "file_path" or "mask_path".
        path: as written there.
    """

    where: str
    key: str
    path: str


@dataclass(kw_only=True)
class Finder:
    """Finds the files of one scene folder and remembers what was spelled otherwise.

    Attributes:
        root: the scene's folder; nothing outside of it is read.
        spelled: how names were read that are not those of files -> how many.
    """

    root: Path
    spelled: Counter[str] = field(default_factory=Counter[str])
    _listed: dict[Path, _Listing] = field(default_factory=dict[Path, _Listing])

    def find_all(self, wanted: Sequence[Wanted]) -> list[Path]:
        """Return the files, resolved, in the order of their names.

        Raises:
            SceneError: names all that are missing, with their number; or the first that lies
                outside of the folder, or whose name fits several files.
        """
        found = [self.find(one) for one in wanted]
        missing = [one for one, path in zip(wanted, found, strict=True) if path is None]
        if missing:
            raise SceneError(self._say_missing(missing, len(wanted)))
        return [path for path in found if path is not None]

    def find(self, wanted: Wanted) -> Path | None:
        """Return one file, resolved, or None where there is none.

        Raises:
            SceneError: it lies outside of the folder, or its name fits several files.
        """
        name = _plain(wanted)
        for candidate in (name, *(f"{name}{end}" for end in (".png", ".jpg", ".jpeg"))):
            path = self._inside(wanted, Path(f"{self.root / candidate}"))
            if is_file(path):
                return path
        slashes = name.replace("\\", "/")
        path = self._inside(wanted, self.root / slashes)
        for written in (slashes, slashes.removeprefix("./")):
            found = path if is_file(path) else self._spelled_otherwise(wanted, written)
            if found is not None:
                self.spelled[_difference(name, slashes, found)] += 1
                return found
        return None

    def notes(self, what: str) -> tuple[str, ...]:
        """One sentence for every other spelling that names were found under.

        Args:
            what: whose names they are, such as a file.
        """
        return tuple(f"{what}: {how}, in {count} names" for how, count in self.spelled.items())

    def _inside(self, wanted: Wanted, path: Path) -> Path:
        home, resolved = self.root.resolve(), resolved_link(path)
        if resolved.is_relative_to(home):
            return resolved
        raise SceneError(
            f"{wanted.where}: '{wanted.key}' leaves the scene's folder {home} (it leads to "
            f"{resolved}); scenes may only read their own files: copy the image into the folder"
            f"{self._elsewhere(wanted)}"
        )

    def _spelled_otherwise(self, wanted: Wanted, name: str) -> Path | None:
        """The one file whose folders and name are the same but for case, form and ending."""
        folder = self.root
        parts = PurePosixPath(name).parts
        for part in parts[:-1]:
            fitting = [path for path in self._listing(folder).get(_key(part), []) if path.is_dir()]
            if part == "..":
                fitting = [folder.parent]
            if len(fitting) != 1:
                return None
            folder = fitting[0]
        if not parts:
            return None
        listing = self._listing(folder)
        for keys in _keys_of_file(parts[-1]):
            fitting = sorted(
                {path for key in keys for path in listing.get(key, []) if path.is_file()}
            )
            if len(fitting) > 1:
                raise SceneError(
                    f"{wanted.where}: '{wanted.key}' {wanted.path!r} is no file, and "
                    f"{' and '.join(repr(path.name) for path in fitting)} have nearly that name; "
                    "write which is meant"
                )
            if fitting:
                return self._inside(wanted, fitting[0])
        return None

    def _listing(self, folder: Path) -> _Listing:
        """Entries of a folder by their names without case and normal form."""
        if folder not in self._listed:
            entries: _Listing = {}
            for path in sorted(folder.iterdir()) if folder.is_dir() else []:
                entries.setdefault(_key(path.name), []).append(path)
            self._listed[folder] = entries
        return self._listed[folder]

    def _say_missing(self, missing: Sequence[Wanted], count: int) -> str:
        first = missing[0]
        what = "mask" if first.key == "mask_path" else "image"
        hint = self._elsewhere(first)
        if len(missing) == 1:
            return (
                f"{first.where}: no {what} at {self.root / first.path} (nor with another ending, "
                f"{', '.join(ENDINGS)}); put it there or remove the frame{hint}"
            )
        scene = first.where.split(", frame ")[0]
        names = ", ".join(one.path for one in missing[:_NAMED])
        more = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
        return (
            f"{scene}: no {what} at the place that {len(missing)} of {count} frames name, with any "
            f"ending ({', '.join(ENDINGS)}): {names}{more}; put them there or remove their frames"
            f"{hint}"
        )

    def _elsewhere(self, wanted: Wanted) -> str:
        """Where in the folder files of that name lie; empty when there are none."""
        name = PureWindowsPath(wanted.path).name
        keys = {key for keys in _keys_of_file(name) for key in keys}
        found: list[str] = []
        seen = 0
        for folder, _, files in os.walk(self.root):
            seen += len(files)
            if seen > _SEARCHED:
                break
            # A link that leads out is what is refused, and no place to advise.
            inner = [one for file in files if not (one := Path(folder, file)).is_symlink()]
            places = [place.relative_to(self.root) for place in inner]
            found += [place.as_posix() for place in places if _key(place.name) in keys]
        if not found:
            return ""
        listed = ", ".join(sorted(found)[:3])
        return f". A file of that name is there: {listed}; write it so, relative to the folder"


def is_file(path: Path) -> bool:
    """Whether there is such a file; a name that is too long, an error to pathlib, is none."""
    return os.path.isfile(path)  # noqa: PTH113


def _plain(wanted: Wanted) -> str:
    """The path as it is written, when systems can have one like it."""
    if "\0" in wanted.path:
        raise SceneError(f"{wanted.where}: '{wanted.key}' contains a zero byte; write a plain path")
    try:
        longest = max(len(os.fsencode(part)) for part in re.split(r"[/\\]", wanted.path))
    except UnicodeEncodeError as problem:
        raise SceneError(
            f"{wanted.where}: '{wanted.key}' contains half of a Unicode letter; write a plain path"
        ) from problem
    # Room for an ending within the 255 bytes that file systems allow.
    if longest > _LONGEST_NAME or len(wanted.path) > _LONGEST_PATH:
        raise SceneError(
            f"{wanted.where}: '{wanted.key}' is too long for the name of a file; write a plain path"
        )
    return wanted.path


def _key(name: str) -> str:
    """The same for names that differ in case or Unicode normal form only."""
    return unicodedata.normalize("NFC", name).casefold()


def _keys_of_file(name: str) -> list[list[str]]:
    """Keys that a file of a name may have, the nearest first: itself, then other endings."""
    plain = PurePosixPath(name)
    stem = plain.stem if plain.suffix.lower() in ENDINGS else name
    return [[_key(name)], [_key(stem + end) for end in ENDINGS]]


def _difference(written: str, slashes: str, found: Path) -> str:
    """In what a file's name differs from the written one."""
    name = PurePosixPath(slashes).name
    if _key(name) != _key(found.name):
        ending = PurePosixPath(name).suffix.lower()
        if ending not in ENDINGS:
            return f"images end in {found.suffix}"
        return f"images end in {found.suffix} and not in {ending}"
    if written != slashes:
        return "backslashes are read as slashes"
    if unicodedata.normalize("NFC", name) == unicodedata.normalize("NFC", found.name):
        return "names are spelled in another Unicode form than those of the files"
    return "names are written in other case than those of the files"
