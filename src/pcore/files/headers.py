"""Files of ours that lie beside a model: named tensors and a header, checked when they are read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from pcore.errors import CheckpointError
from pcore.files.atomic import write_atomically
from pcore.files.provenance import pcore_version


@dataclass(frozen=True, kw_only=True)
class Companion:
    """A kind of such files, NOUN.safetensors.

    Attributes:
        noun: what it holds.
        version: of the format; no other is read.
        mend: for messages, what to do about a file that cannot be used.
    """

    noun: str
    version: str
    mend: str

    @property
    def name(self) -> str:
        """Name of the file in a run folder."""
        return f"{self.noun}.safetensors"

    def path(self, given: Path | str) -> Path:
        """Path of the file, given it or the run folder that holds it."""
        path = Path(given)
        return path / self.name if path.is_dir() else path

    def write(self, path: Path, tensors: Mapping[str, Tensor], **header: str) -> None:
        """Write a file; a crash at any moment leaves the old file or the new one.

        Raises:
            OSError: the file cannot be written; the old one is untouched.
        """
        plain = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
        header = {"format": self.format, "version": self.version, **header}
        write_atomically(path, save(plain, metadata=header))

    def read(self, path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
        """Header and tensors of a file.

        Raises:
            CheckpointError: missing, damaged, not ours or of another version.
        """
        if not path.is_file():
            raise CheckpointError(f"no {self.noun} at {path}: expected a {self.name}; {self.mend}")
        try:
            with safe_open(path, framework="pt") as file:
                header: dict[str, str] = file.metadata() or {}
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        except SafetensorError as error:
            raise CheckpointError(
                f"{path} is damaged or not a safetensors file: expected a {self.name} "
                f"written by pcore; {self.mend}"
            ) from error
        if header.get("format") != self.format or header.get("version") != self.version:
            raise CheckpointError(
                f"{path}: expected the format '{self.format}' of version {self.version}, got "
                f"{header.get('format')!r} of version {header.get('version')!r}; this is pcore "
                f"{pcore_version()}; {self.mend}"
            )
        return header, tensors

    def values(self, path: Path, header: Mapping[str, str], key: str) -> dict[str, Any]:
        """JSON object under a key of a header; raises CheckpointError where it is none."""
        try:
            found: Any = json.loads(header.get(key, ""))
        except (ValueError, RecursionError):
            found = None
        if not isinstance(found, dict):
            raise CheckpointError(
                f"{path}: expected a JSON object under '{key}' of the header, got "
                f"{header.get(key)!r:.60}; the file was edited, {self.mend}"
            )
        return cast("dict[str, Any]", found)

    def check_finite(self, path: Path, tensors: Mapping[str, Tensor]) -> None:
        """Raise CheckpointError where a tensor has NaN or infinity."""
        bad = [name for name, value in tensors.items() if not bool(torch.isfinite(value).all())]
        if bad:
            raise CheckpointError(
                f"{path}: expected finite numbers, got NaN or infinity in {', '.join(bad[:4])}; "
                f"{self.mend}"
            )

    @property
    def format(self) -> str:
        """Name of the format in headers."""
        return f"pcore-{self.noun}"


def name_in_folder(path: Path) -> str | None:
    """Name that a file has in a run folder, by its header; None for files that are not ours."""
    try:
        with safe_open(path, framework="pt") as file:
            form = (file.metadata() or {}).get("format", "")
    except (OSError, SafetensorError):
        return None
    return f"{form.removeprefix('pcore-')}.safetensors" if form.startswith("pcore-") else None
