"""Files that edits name, kept in memory: one that is lost is written again when edits are."""

from __future__ import annotations

from pathlib import Path

from pcore.editing.animation import with_files
from pcore.editing.stack import Stack
from pcore.files.atomic import write_atomically


class MeshFiles:
    """What is in the files of meshes that edits name."""

    def __init__(self, folder: Path) -> None:
        """Begin with none.

        Args:
            folder: the only one that is written to.
        """
        self._folder, self._known = folder.resolve(), dict[Path, bytes]()

    def see(self, stack: Stack) -> None:
        """Read those of edits that are not known yet; one that is gone stays unknown."""
        for path in _files_of(stack) - self._known.keys():
            if path.parent == self._folder and path.is_file():
                self._known[path] = path.read_bytes()

    def mend(self, stack: Stack) -> list[str]:
        """Write those of edits that are gone; return the names of those that nobody knows.

        Raises:
            OSError: one cannot be written.
        """
        gone = {path for path in _files_of(stack) if not path.is_file()}
        for path in gone & self._known.keys():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, self._known[path])
        return sorted(path.name for path in gone - self._known.keys())


def _files_of(stack: Stack) -> set[Path]:
    found: set[Path] = set()

    def note(name: str) -> str:
        found.add(Path(name).resolve())
        return name

    with_files(stack.content, note)
    return found
