"""The file `light.safetensors` beside a model: the light of its photos, normals of its points."""

from __future__ import annotations

from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from pcore.errors import CheckpointError, InputError
from pcore.geometry.light import Light, Shading
from pcore.model.atomic import write_atomically
from pcore.model.provenance import pcore_version

LIGHT_FILE = "light.safetensors"
_FORMAT = "pcore-light"
_VERSION = "1"
_TENSORS = ("directions", "radiance", "normals", "positions")


def save_shading(path: Path, shading: Shading, positions: Tensor) -> None:
    """Write a light file; a crash at any moment leaves the old file or the new one.

    Args:
        path: where to, normally RUN/light.safetensors.
        shading: the light and the normals.
        positions: (N, 3) canonical points that the normals belong to, world units.

    Raises:
        OSError: the file cannot be written; the old one is untouched.
    """
    light = shading.light
    tensors = (light.directions, light.radiance, shading.normals, positions)
    plain = {
        name: value.detach().cpu().contiguous()
        for name, value in zip(_TENSORS, tensors, strict=True)
    }
    header = {"format": _FORMAT, "version": _VERSION}
    write_atomically(path, save(plain, metadata=header))


def load_shading(path: Path | str, positions: Tensor) -> Shading:
    """Read a light file.

    Args:
        path: the file, or the run folder that holds it.
        positions: (N, 3) canonical points of the model it lies beside.

    Raises:
        CheckpointError: missing, damaged, not ours, of another version, or of other points.
    """
    path = Path(path)
    path = path / LIGHT_FILE if path.is_dir() else path
    tensors = _read(path)
    missing = [name for name in _TENSORS if name not in tensors]
    bad = [name for name, value in tensors.items() if not bool(torch.isfinite(value).all())]
    if missing or bad:
        raise CheckpointError(
            f"{path}: expected finite tensors {', '.join(_TENSORS)}, got "
            f"{'none' if missing else 'NaN or infinity'} in {', '.join(missing or bad)}; {_MEND}"
        )
    if not torch.equal(tensors["positions"], positions.detach().cpu()):
        raise CheckpointError(
            f"{path}: expected the points that the light was estimated with, got "
            f"{len(positions)} others; {_MEND}"
        )
    try:
        light = Light(directions=tensors["directions"], radiance=tensors["radiance"])
        return Shading(light=light, normals=tensors["normals"])
    except InputError as error:
        raise CheckpointError(f"{path}: {error}; {_MEND}") from error


_MEND = "estimate it anew with `pcore light RUN`, or delete the file"


def _read(path: Path) -> dict[str, Tensor]:
    if not path.is_file():
        raise CheckpointError(f"no light at {path}: expected a {LIGHT_FILE}; `pcore light RUN`")
    try:
        with safe_open(path, framework="pt") as file:
            header: dict[str, str] = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise CheckpointError(
            f"{path} is damaged or not a safetensors file ({error}); {_MEND}"
        ) from error
    if header.get("format") != _FORMAT or header.get("version") != _VERSION:
        raise CheckpointError(
            f"{path}: expected the format '{_FORMAT}' of version {_VERSION}, got "
            f"{header.get('format')!r} of version {header.get('version')!r}; this is pcore "
            f"{pcore_version()}; {_MEND}"
        )
    return tensors
