"""Torch's tensors and threads, as the kernels by numba see them."""

from __future__ import annotations

import numba
import numpy as np
import torch
from numba.core import config as numba_config
from torch import Tensor


def use_torch_threads() -> int:
    """Let numba use as many threads as torch; return how many that are."""
    # numba fills its config in at import, where type checkers do not see it.
    most: int = numba_config.NUMBA_NUM_THREADS  # pyright: ignore[reportAttributeAccessIssue]
    threads = min(torch.get_num_threads(), most)
    numba.set_num_threads(threads)
    return threads


def as_float32(tensor: Tensor) -> np.ndarray:
    """Return the values, contiguous, without gradient."""
    return np.ascontiguousarray(tensor.detach().to(torch.float32).numpy())
