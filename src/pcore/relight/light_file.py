"""The file `light.safetensors` beside a model: the light of its photos and what it fell on."""

from __future__ import annotations

import json
from pathlib import Path

import torch
from torch import Tensor

from pcore.errors import CheckpointError, InputError
from pcore.files.headers import Companion
from pcore.files.records import from_dict, to_dict
from pcore.relight.lamps import Light
from pcore.relight.relight_config import RelightConfig
from pcore.relight.relighting import Relighting

_FILE = Companion(
    noun="light", version="4", mend="estimate it anew with `pcore light RUN`, or delete the file"
)
LIGHT_FILE = _FILE.name
_LIGHT = ("directions", "radiance", "nearness", "center")
_POINTS = ("positions", "brightness", "received")
_TENSORS = (*_LIGHT, *_POINTS)


def save_light(path: Path, relighting: Relighting) -> None:
    """Write a light file; a crash at any moment leaves the old file or the new one.

    Args:
        path: where to, normally RUN/light.safetensors.
        relighting: the light, and the canonical points that it fell on.

    Raises:
        OSError: the file cannot be written; the old one is untouched.
    """
    light = {name: getattr(relighting.light, name) for name in _LIGHT}
    points = {name: getattr(relighting, name) for name in _POINTS}
    _FILE.write(path, light | points, config=json.dumps(to_dict(relighting.config)))


def load_light(path: Path | str, positions: Tensor) -> Relighting:
    """Read a light file.

    Args:
        path: the file, or the run folder that holds it.
        positions: (N, 3) canonical points of the model it lies beside.

    Raises:
        CheckpointError: missing, damaged, not ours, of another version, or of other points.
    """
    path = _FILE.path(path)
    header, tensors = _FILE.read(path)
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
        config = from_dict(
            RelightConfig, _FILE.values(path, header, "config"), where=f"{path}: config"
        )
        light = Light(**{name: tensors[name] for name in _LIGHT})
        return Relighting(light=light, config=config, **{name: tensors[name] for name in _POINTS})
    except InputError as error:
        raise CheckpointError(f"{path}: {error}; {_FILE.mend}") from error
