"""Who else is compared: folders of pictures of other code, under names of their own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pcore.errors import InputError
from pcore.evaluation.contest import Contestant, Entry
from pcore.evaluation.picture_method import open_pictures


def picture_entries(folders: Sequence[tuple[str, Path]], beside: Sequence[Entry]) -> list[Entry]:
    """Entries of folders of pictures, by the names that they have in tables.

    Args:
        folders: names and places.
        beside: the other methods, whose rows theirs must not be.

    Raises:
        InputError: a name, but for its capitals, is another method's.
    """
    taken = {one.name.casefold(): one.name for one in beside}
    for name, folder in folders:
        other = taken.get(name.casefold())
        if other is not None:
            raise InputError(
                f"--pictures {name}={folder}: expected a name that no other method has, also "
                f"without capitals, got that of {other!r}; choose another name"
            )
        taken[name.casefold()] = name
    return [
        Entry(
            name=name,
            setting="given",
            seed=0,
            stamp=_stamp_of_folder(folder),
            make=lambda name=name, folder=folder: Contestant(method=open_pictures(name, folder)),
        )
        for name, folder in folders
    ]


def _stamp_of_folder(folder: Path) -> list[list[str | int]]:
    files = sorted(folder.glob("*/*")) if folder.is_dir() else []
    return [[str(one), one.stat().st_size, one.stat().st_mtime_ns] for one in files]
