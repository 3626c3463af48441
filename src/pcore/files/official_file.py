"""Reading the original's `model.pth`, a pickle from strangers, without executing it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor

from pcore.errors import CheckpointError


def read_tensors(path: Path) -> tuple[int | None, dict[str, Tensor]]:
    """Read `{"<step>": state_dict}` or a bare state dict.

    Args:
        path: the file that the original's `torch.save` wrote.

    Returns:
        The step (None for a bare state dict) and the tensors by name, on the CPU.

    Raises:
        CheckpointError: the file is missing, damaged, or holds anything but dense real tensors.
    """
    return _split_step(_load_pickle(path), path)


def _load_pickle(path: Path) -> Any:
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        raise CheckpointError(
            f"{path}: expected the original's model.pth, found {found}; check the path"
        )
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # a damaged or hostile pickle can make the reader raise anything
        raise CheckpointError(
            f"{path}: expected a PyTorch file that holds nothing but tensors, got one that is "
            "damaged, cut short or contains Python objects; nothing in it was executed. Download "
            "it again, or ask its author for the plain state dict"
        ) from error


def _split_step(data: Any, path: Path) -> tuple[int | None, dict[str, Tensor]]:
    """Separate `{"<step>": state_dict}`; a bare state dict has no step."""
    step: int | None = None
    if isinstance(data, dict) and len(cast("dict[Any, Any]", data)) == 1:
        key, value = next(iter(cast("dict[Any, Any]", data).items()))
        if isinstance(value, dict) and str(key).isdigit():
            step, data = int(key), value
    if not isinstance(data, dict) or not data:
        raise CheckpointError(
            f"{path}: expected {{step: state dict}} or a state dict of the original PAPR, got "
            f"{_describe(data)}"
        )
    tensors = cast("dict[Any, Any]", data)
    for name, value in tensors.items():
        if not (isinstance(name, str) and isinstance(value, Tensor) and _is_plain(value)):
            raise CheckpointError(
                f"{path}: expected {{step: state dict}} or a state dict of the original PAPR, got "
                f"an entry {str(name)[:60]!r} that is no array of real numbers"
            )
    return step, cast("dict[str, Tensor]", tensors)


def _is_plain(tensor: Tensor) -> bool:
    """Whether it is a dense array of real numbers (not sparse, quantised or complex)."""
    return tensor.layout == torch.strided and not (tensor.is_quantized or tensor.is_complex())


def _describe(data: Any) -> str:
    if isinstance(data, dict):
        return "nothing at all"
    return "one tensor" if isinstance(data, Tensor) else "something else"
