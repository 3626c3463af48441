"""Threads of torch and of numba's loops."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import torch

from pcore.geometry.torch_threads import one_thread

STARTED = """
import torch
from pcore.geometry.torch_threads import use_torch_threads
torch.set_num_threads(1)
print(use_torch_threads(), torch.get_num_threads())
"""


def test_the_first_loop_of_numba_leaves_torch_its_threads() -> None:
    """Numba starts two, and would give them to torch, whose sums then end in other bits."""
    ended = subprocess.run(
        [sys.executable, "-c", STARTED],
        env={**os.environ, "NUMBA_NUM_THREADS": "2"},
        check=True,
        capture_output=True,
        text=True,
    )
    assert ended.stdout.split() == ["1", "1"]


def test_threads_come_back_after_one_alone_even_where_it_fails() -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(3)

    def fail() -> None:
        raise ValueError(f"in {torch.get_num_threads()}")

    try:
        with pytest.raises(ValueError, match="in 1"), one_thread():
            fail()
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)
