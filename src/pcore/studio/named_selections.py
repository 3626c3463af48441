"""Selections that have a name: masks of points in files beside the edits."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from pcore.data.points import read_array
from pcore.editing.selection import save_mask
from pcore.errors import EditError, InputError
from pcore.studio.guard import is_file_name

_ENDING = ".npy"


@dataclass(frozen=True, kw_only=True)
class NamedSelections:
    """Those of one object.

    Attributes:
        folder: of the files; made when first needed.
        count: of the points.
    """

    folder: Path
    count: int

    @property
    def names(self) -> list[str]:
        """In their alphabetical order."""
        return sorted(path.stem for path in self.folder.glob(f"*{_ENDING}"))

    def read(self, name: str) -> Tensor:
        """Points (N,) bool of a selection.

        Raises:
            InputError: there is none of this name, or its file cannot be read.
            EditError: it is of another object.
        """
        path = self._path(name)
        if not path.is_file():
            raise InputError(f"selection: there is none with the name {name!r}")
        mask = read_array(path)
        if mask.shape != (self.count,) or mask.dtype != bool:
            raise EditError(
                f"selection {name}: expected true or false for each of {self.count} points, got "
                f"{mask.dtype} {mask.shape}; it belongs to another object"
            )
        return torch.from_numpy(mask)

    def keep(self, name: str, mask: Tensor) -> None:
        """Keep points (N,) bool under a name; an older one of this name is replaced.

        Raises:
            InputError: a name that is none.
            EditError: nothing is selected, or the file cannot be written.
        """
        path = self._path(name)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise EditError(f"selection: cannot be kept ({error.strerror})") from error
        save_mask(path, mask)

    def forget(self, name: str) -> None:
        """Remove one; nothing where there is none."""
        self._path(name).unlink(missing_ok=True)

    def _path(self, name: str) -> Path:
        if not is_file_name(name):
            raise InputError(
                f"name of a selection: expected letters, numbers and - _ ., got {name!r}"
            )
        return self.folder / f"{name}{_ENDING}"
