"""The file `skinning.safetensors` beside a model: its anchors and the fitted network."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from pcore.deform.anchor_distance import path_distance
from pcore.errors import CheckpointError
from pcore.model.atomic import write_atomically
from pcore.model.provenance import pcore_version
from pcore.model.records import from_dict, to_dict
from pcore.model.skinning import Skinning, SkinningConfig, SkinningNetwork

SKINNING_FILE = "skinning.safetensors"
_FORMAT = "pcore-skinning"
_VERSION = 1
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
    _check_finite(path, tensors)
    header = {
        "format": _FORMAT,
        "version": str(_VERSION),
        "config": json.dumps(to_dict(network.config)),
    }
    plain = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    write_atomically(path, save(plain, metadata=header))


def load_skinning(path: Path | str, points: Tensor) -> Skinning:
    """Read a skinning file and measure the paths over its cloud again (seconds).

    Args:
        path: the file, or the run folder that holds it.
        points: (N, 3) canonical points of the model it was fitted to, world units.

    Raises:
        CheckpointError: missing, damaged, not ours, of another version, or fitted to other points.
    """
    path = _skinning_path(path)
    config, tensors = _read(path)
    _check_finite(path, tensors)
    indices = _anchors(path, tensors, points)
    network = SkinningNetwork(config, len(indices))
    state = {k.removeprefix(_NETWORK): v for k, v in tensors.items() if k.startswith(_NETWORK)}
    try:
        network.load_state_dict(state)
    except RuntimeError as error:
        raise CheckpointError(
            f"{path}: the weights are not those of its configuration ({error}); "
            "the file was edited, fit the skinning again"
        ) from error
    return Skinning(network=network.eval(), paths=path_distance(points.detach().cpu(), indices))


def describe_skinning(path: Path | str) -> SkinningSummary:
    """Read what a skinning file (or its run folder) says about itself.

    Raises:
        CheckpointError: missing, damaged, not ours or of another version.
    """
    path = _skinning_path(path)
    config, tensors = _read(path)
    return SkinningSummary(config=config, anchors=len(tensors.get("anchors", ())))


def _skinning_path(given: Path | str) -> Path:
    path = Path(given)
    return path / SKINNING_FILE if path.is_dir() else path


def _read(path: Path) -> tuple[SkinningConfig, dict[str, Tensor]]:
    """Configuration and tensors of a file, after checking that it is one of ours."""
    header, tensors = _open(path)
    if header.get("format") != _FORMAT or header.get("version") != str(_VERSION):
        raise CheckpointError(
            f"{path}: expected the format '{_FORMAT}' of version {_VERSION}, got "
            f"{header.get('format')!r} of version {header.get('version')!r}; this is pcore "
            f"{pcore_version()}, fit the skinning again"
        )
    return from_dict(SkinningConfig, _config(path, header), where=f"{path}: config"), tensors


def _open(path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
    if not path.is_file():
        raise CheckpointError(f"no skinning at {path}: expected a {SKINNING_FILE}; fit one first")
    try:
        with safe_open(path, framework="pt") as file:
            header: dict[str, str] = file.metadata() or {}
            return header, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise CheckpointError(
            f"{path} is damaged or not a safetensors file ({error}): expected a {SKINNING_FILE} "
            "written by pcore; fit the skinning again"
        ) from error


def _config(path: Path, header: dict[str, str]) -> object:
    try:
        return json.loads(header.get("config", ""))
    except json.JSONDecodeError as error:
        raise CheckpointError(
            f"{path}: expected JSON under 'config' of the header, got "
            f"{header.get('config')!r:.60}; the file was edited, fit the skinning again"
        ) from error


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


def _check_finite(path: Path, tensors: dict[str, Tensor]) -> None:
    bad = [name for name, value in tensors.items() if not bool(torch.isfinite(value).all())]
    if bad:
        raise CheckpointError(
            f"{path}: expected finite numbers, got NaN or infinity in {', '.join(bad[:4])}; "
            "the fit diverged, lower its learning rate"
        )
