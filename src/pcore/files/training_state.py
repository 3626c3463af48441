"""The state of a training: all that the next step depends on, in one file.

`state.pt` alone is the truth for going on: it holds the weights itself. The `model.safetensors`
beside it is for users, written from the same state. A kill between the two writes leaves a model
that is one save older or newer than the state, never a state made of two.
"""

from __future__ import annotations

import io
import pickle
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor

from pcore.errors import CheckpointError
from pcore.files.atomic import write_atomically

STATE_FILE = "state.pt"
_FORMAT = "pcore-state"
_VERSION = 3

Plain = dict[str, Any]
"""Nested dicts, lists and tuples of tensors, numbers, strings, booleans and None."""


def _empty() -> Plain:
    return {}


@dataclass(frozen=True, kw_only=True)
class TrainingState:
    """A training between two steps.

    Attributes:
        stage: "pretrain" or "finetune".
        step: steps done; the next one is `step`, counted from 0.
        papr: state dict of the networks.
        cloud: `positions`, `features` and `influence` of the points.
        optimisers: state dict of every optimiser (and scheduler, scaler) by name.
        generators: state of every random generator by name, see `generator_states`.
        best: the best validation so far (its figures, and its weights where they are kept).
        skinning: state dict of the skinning network; empty where none is trained.
    """

    stage: str
    step: int
    papr: dict[str, Tensor]
    cloud: dict[str, Tensor]
    optimisers: Plain
    generators: Plain
    best: Plain = field(default_factory=_empty)
    skinning: dict[str, Tensor] = field(default_factory=dict[str, Tensor])


_TYPES: dict[str, type] = {"stage": str, "step": int}


def save_state(path: Path, state: TrainingState) -> None:
    """Write a state; a crash at any moment leaves the old file or the new one, both loadable.

    Tensors are written as they are now; the state may share them with the running training.

    Raises:
        TypeError: the state holds an object that a safe reader would refuse (our own bug).
        OSError: the file cannot be written; the old one is untouched.
    """
    content = {item.name: getattr(state, item.name) for item in fields(state)}
    plain = {"format": _FORMAT, "version": _VERSION, "state": _plain(content, "state")}
    # Into memory first: torch reports a full disk as a RuntimeError without errno.
    buffer = io.BytesIO()
    torch.save(plain, buffer)
    write_atomically(path, buffer.getbuffer())


def load_state(path: Path) -> TrainingState:
    """Read a state; tensors on the CPU. Nothing in the file is executed.

    Raises:
        CheckpointError: the file is missing, truncated, damaged, not ours or of another version.
    """
    content = _read(path)
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise CheckpointError(
            f"{path} is not a training state of pcore: expected the format '{_FORMAT}'; "
            "give the folder of a run that `pcore train` or `pcore finetune` made"
        )
    if content.get("version") != _VERSION:
        raise CheckpointError(
            f"{path} has version {content.get('version')!r} of the state format: this pcore reads "
            f"version {_VERSION}; go on with the pcore that wrote it"
        )
    state = cast("Plain", content.get("state", {}))
    names = {item.name: _TYPES.get(item.name, dict) for item in fields(TrainingState)}
    wrong = sorted({*state} ^ {*names})
    wrong += [n for n, kind in names.items() if n in state and not isinstance(state[n], kind)]
    if wrong:
        raise CheckpointError(
            f"{path}: missing, unknown or ill-typed entries {', '.join(wrong)}; the file was "
            "edited or is damaged, train anew into another folder"
        )
    return TrainingState(**state)


def generator_states(generators: Mapping[str, torch.Generator]) -> Plain:
    """Return the states of named generators and of torch's global ones (CPU, CUDA)."""
    states: Plain = {name: one.get_state() for name, one in generators.items()}
    states["torch"] = torch.get_rng_state()
    if torch.cuda.is_available():
        states["cuda"] = torch.cuda.get_rng_state()
    return states


def restore_generators(
    generators: Mapping[str, torch.Generator], states: Mapping[str, Any]
) -> None:
    """Put generators back to what `generator_states` returned.

    Raises:
        CheckpointError: the names are others than those that were saved.
    """
    if {*generators} != {*states} - {"torch", "cuda"}:
        raise CheckpointError(
            f"training state: expected random generators {sorted(generators)}, got "
            f"{sorted({*states} - {'torch', 'cuda'})}; go on with the pcore that wrote it"
        )
    for name, one in generators.items():
        one.set_state(states[name])
    torch.set_rng_state(states["torch"])
    if "cuda" in states and torch.cuda.is_available():
        torch.cuda.set_rng_state(states["cuda"])


def _read(path: Path) -> Any:
    if not path.is_file():
        raise CheckpointError(
            f"no training state at {path}: expected a {STATE_FILE}; the run never reached its "
            "first checkpoint, or the path is wrong"
        )
    try:
        with zipfile.ZipFile(path) as archive:
            # torch does not compare checksums; a flipped bit would train on silently.
            damaged = archive.testzip()
    except zipfile.BadZipFile as error:
        raise CheckpointError(
            f"{path} is truncated or not a file of torch; take the run from a backup "
            "or train anew into another folder"
        ) from error
    if damaged is not None:
        raise CheckpointError(
            f"{path} is damaged: the checksum of '{damaged}' is wrong; take the run from a "
            "backup or train anew into another folder"
        )
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError, EOFError, KeyError) as error:
        raise CheckpointError(
            f"{path} holds more than tensors and numbers, or is damaged: expected a training "
            "state of pcore; nothing in it was executed, do not trust where it comes from"
        ) from error


def _plain(value: Any, where: str) -> Any:
    """Return `value` with compact CPU tensors; raise on what `weights_only` would refuse."""
    if isinstance(value, Tensor):
        tensor = value.detach().cpu()
        # A view would drag the whole storage behind it into the file.
        return tensor.clone() if _is_part(tensor) else tensor
    if isinstance(value, Mapping):
        items = cast("Mapping[Any, Any]", value)
        return {key: _plain(one, f"{where}.{key}") for key, one in items.items()}
    if isinstance(value, (list, tuple)):
        parts = [_plain(one, f"{where}[]") for one in cast("list[Any]", value)]
        return tuple(parts) if isinstance(value, tuple) else parts
    if value is None or type(value) in (bool, int, float, str):
        return value
    raise TypeError(
        f"training state: {where} is a {type(value).__name__}; expected tensors, numbers, "
        "strings, booleans, None and dicts, lists, tuples of them (use `.item()` or `.tolist()`)"
    )


def _is_part(tensor: Tensor) -> bool:
    return tensor.untyped_storage().nbytes() != tensor.numel() * tensor.element_size()
