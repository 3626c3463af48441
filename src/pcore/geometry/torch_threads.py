"""As many threads in numba's loops as torch has, and no more in torch; or one for a while."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

import numba
import torch
from numba.core import config as numba_config


def use_torch_threads() -> int:
    """Let numba use as many threads as torch; return how many that are.

    To be called before every loop of numba that is parallel.
    """
    # numba fills its config in at import, where type checkers do not see it.
    most: int = numba_config.NUMBA_NUM_THREADS  # pyright: ignore[reportAttributeAccessIssue]
    wanted = torch.get_num_threads()
    threads = min(wanted, most)
    numba.set_num_threads(threads)
    # Its first call in a process starts all threads of OpenMP, whose number is torch's as well.
    if torch.get_num_threads() != wanted:
        torch.set_num_threads(wanted)
    return threads


@contextmanager
def one_thread() -> Generator[None]:
    """Compute in one thread for a while: for what takes milliseconds while something moves.

    Threads that wait for the next loop spin, which takes more of the processor than they save, and
    takes it from the browser that is to draw. The number is one of the process: not for two threads
    of it at a time.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
