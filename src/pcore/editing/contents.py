"""Tensors as keys of caches, by what they hold."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import DTypeLike
from torch import Tensor


def content_of(values: Tensor) -> bytes:
    """Numbers of a tensor, as a key by what it holds."""
    return values.detach().cpu().numpy().tobytes()


def from_content(content: bytes, kind: DTypeLike = np.float64) -> Tensor:
    """Return the rows of three that `content_of` was given."""
    return torch.from_numpy(np.frombuffer(content, dtype=kind).reshape(-1, 3).copy())
