"""Torch's tensors, as the kernels by numba see them."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def as_float32(tensor: Tensor) -> np.ndarray:
    """Return the values, contiguous, without gradient."""
    return np.ascontiguousarray(tensor.detach().to(torch.float32).numpy())


def as_array(tensor: Tensor) -> np.ndarray:
    """Return the values in their own type, contiguous, without gradient."""
    return np.ascontiguousarray(tensor.detach().numpy())
