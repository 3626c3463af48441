"""The file `light.safetensors` beside a model: the light of its photos and what it falls on."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from pcore.errors import CheckpointError, InputError
from pcore.files.headers import Companion
from pcore.relight.lamps import Light
from pcore.relight.shading import Shading

_FILE = Companion(
    noun="light", version="3", mend="estimate it anew with `pcore light RUN`, or delete the file"
)
LIGHT_FILE = _FILE.name
_LIGHT = ("directions", "radiance", "nearness", "center")
_POINTS = ("normals", "positions", "brightness")
_LIFT = "lift"
_TENSORS = (*_LIGHT, *_POINTS, _LIFT)


def save_shading(path: Path, shading: Shading) -> None:
    """Write a light file; a crash at any moment leaves the old file or the new one.

    Args:
        path: where to, normally RUN/light.safetensors.
        shading: the light, and the canonical points that it falls on.

    Raises:
        OSError: the file cannot be written; the old one is untouched.
    """
    light = {name: getattr(shading.light, name) for name in _LIGHT}
    points = {name: getattr(shading, name) for name in _POINTS}
    _FILE.write(path, light | points | {_LIFT: torch.tensor(shading.lift, dtype=torch.float32)})


def load_shading(path: Path | str, positions: Tensor) -> Shading:
    """Read a light file.

    Args:
        path: the file, or the run folder that holds it.
        positions: (N, 3) canonical points of the model it lies beside.

    Raises:
        CheckpointError: missing, damaged, not ours, of another version, or of other points.
    """
    path = _FILE.path(path)
    _, tensors = _FILE.read(path)
    missing = [name for name in _TENSORS if name not in tensors]
    if missing:
        raise CheckpointError(
            f"{path}: expected tensors {', '.join(_TENSORS)}, got none for {', '.join(missing)}; "
            f"{_FILE.mend}"
        )
    _FILE.check_finite(path, tensors)
    if not torch.equal(tensors["positions"], positions.detach().cpu()):
        raise CheckpointError(
            f"{path}: expected the points that the light was estimated with, got "
            f"{len(positions)} others; {_FILE.mend}"
        )
    try:
        light = Light(**{name: tensors[name] for name in _LIGHT})
        points = {name: tensors[name] for name in _POINTS}
        return Shading(light=light, **points, lift=_number(tensors[_LIFT]))
    except InputError as error:
        raise CheckpointError(f"{path}: {error}; {_FILE.mend}") from error


def _number(value: Tensor) -> float:
    if value.numel() != 1:
        raise InputError(f"lift: expected one number, got {tuple(value.shape)}")
    return float(value)
