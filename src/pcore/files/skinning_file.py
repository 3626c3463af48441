"""The file `skinning.safetensors` beside a model: its anchors and the fitted network."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from pcore.contrib.learned_skinning import Skinning, SkinningConfig, SkinningNetwork
from pcore.deform.anchor_distance import path_distance
from pcore.errors import CheckpointError
from pcore.files.headers import Companion
from pcore.files.records import from_dict, to_dict

_FILE = Companion(noun="skinning", version="1", mend="fit the skinning again")
SKINNING_FILE = _FILE.name
_NETWORK = "network."


@dataclass(frozen=True, kw_only=True)
class SkinningSummary:
    """What a skinning file says about itself."""

    config: SkinningConfig
    anchors: int


def save_skinning(path: Path, skinning: Skinning) -> None:
    """Write a skinning file; a crash at any moment leaves the old file or the new one.

    Args:
        path: where to, normally RUN/skinning.safetensors.
        skinning: network and anchors; paths are not saved, reading measures them again.

    Raises:
        CheckpointError: weights that are not finite; nothing is written.
        OSError: the file cannot be written; the old one is untouched.
    """
    network, paths = skinning.network, skinning.paths
    tensors = {f"{_NETWORK}{name}": value for name, value in network.state_dict().items()}
    tensors |= {"anchors": paths.indices, "places": paths.anchors}
    _FILE.check_finite(path, tensors)
    _FILE.write(path, tensors, config=json.dumps(to_dict(network.config)))


def load_skinning(path: Path | str, points: Tensor) -> Skinning:
    """Read a skinning file and measure the paths over its cloud again (seconds).

    Args:
        path: the file, or the run folder that holds it.
        points: (N, 3) canonical points of the model it was fitted to, world units.

    Raises:
        CheckpointError: missing, damaged, not ours, of another version, or fitted to other points.
    """
    path = _FILE.path(path)
    config, tensors = _read(path)
    _FILE.check_finite(path, tensors)
    indices = _anchors(path, tensors, points)
    network = SkinningNetwork(config, len(indices))
    state = {k.removeprefix(_NETWORK): v for k, v in tensors.items() if k.startswith(_NETWORK)}
    try:
        network.load_state_dict(state)
    except RuntimeError as error:
        raise CheckpointError(
            f"{path}: the weights are not those of its configuration; "
            "the file was edited, fit the skinning again"
        ) from error
    return Skinning(network=network.eval(), paths=path_distance(points.detach().cpu(), indices))


def describe_skinning(path: Path | str) -> SkinningSummary:
    """Read what a skinning file (or its run folder) says about itself.

    Raises:
        CheckpointError: missing, damaged, not ours or of another version.
    """
    path = _FILE.path(path)
    config, tensors = _read(path)
    return SkinningSummary(config=config, anchors=len(tensors.get("anchors", ())))


def _read(path: Path) -> tuple[SkinningConfig, dict[str, Tensor]]:
    """Configuration and tensors of a file, after checking that it is one of ours."""
    header, tensors = _FILE.read(path)
    return from_dict(
        SkinningConfig, _FILE.values(path, header, "config"), where=f"{path}: config"
    ), tensors


def _anchors(path: Path, tensors: dict[str, Tensor], points: Tensor) -> Tensor:
    """Return the anchors' indices, after checking that the cloud has them where they were."""
    try:
        indices, places = tensors["anchors"], tensors["places"]
        same = torch.equal(points.detach().cpu()[indices], places)
    except (KeyError, IndexError):
        same = False
    if not same:
        raise CheckpointError(
            f"{path}: expected the points that the skinning was fitted to, got {len(points)} "
            "others; give the model that lies beside it, or fit the skinning again"
        )
    return tensors["anchors"]
