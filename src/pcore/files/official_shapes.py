"""Whether the tensors of an official checkpoint are those of its model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from pcore.errors import CheckpointError

_LISTED = 6
"""Names that an error message spells out before it says how many more there are."""


def check_tensors(
    tensors: Mapping[str, Tensor], shapes: Mapping[str, tuple[int, ...]], where: str
) -> None:
    """Raise CheckpointError unless names and shapes are these and all numbers are finite.

    Args:
        tensors: what the file holds.
        shapes: name -> shape of what the model needs.
        where: the file, for messages.
    """
    problems: list[str] = []
    problems += _listing("missing tensor", [n for n in shapes if n not in tensors])
    problems += _listing("unknown tensor", [n for n in tensors if n not in shapes])
    common = [n for n in shapes if n in tensors]
    wrong = [n for n in common if tuple(tensors[n].shape) != shapes[n]]
    problems += _listing(
        "misshaped tensor",
        [f"{n} (expected {shapes[n]}, got {tuple(tensors[n].shape)})" for n in wrong],
    )
    problems += _listing(
        "NaN or infinity in tensor",
        [n for n in common if not bool(torch.isfinite(tensors[n]).all())],
    )
    if problems:
        raise CheckpointError(
            f"{where}: {'; '.join(problems)}; expected a checkpoint of the original PAPR"
        )


def _listing(what: str, names: Sequence[str]) -> list[str]:
    if not names:
        return []
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return [f"{what} {', '.join(names[:_LISTED])}{more}"]
