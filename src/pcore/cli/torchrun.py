"""`torchrun ... pcore VERB`: several processes share the work of a verb; alone without torchrun."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pcore.training.ranks import Ranks


@contextmanager
def joined_ranks(device: str, *, learns: bool = True) -> Generator[Ranks]:
    """Work together with the other processes that torchrun started; alone without it.

    Args:
        device: "cuda": each process takes the GPU of its number on its machine; or "cpu".
        learns: gradients are exchanged, GPU to GPU; else finished work is, on the CPU.
    """
    from datetime import timedelta

    import torch
    import torch.distributed as dist

    from pcore.training.ranks import Ranks, current_ranks

    if _processes() < 2:
        yield Ranks()
        return
    if device == "cuda":
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
    # Whoever has its share waits for the others; torchrun ends all where one fails.
    patience = None if learns else timedelta(days=7)
    dist.init_process_group("nccl" if device == "cuda" and learns else "gloo", timeout=patience)
    try:
        yield current_ranks()
    finally:
        dist.destroy_process_group()


def is_first() -> bool:
    """Whether this process speaks for those that torchrun started; it does alone."""
    return _processes() < 2 or os.environ.get("RANK", "0") == "0"


def refuse_ranks(what: str) -> None:
    """Refuse to do the same work several times."""
    from pcore.errors import InputError

    if _processes() > 1:
        raise InputError(
            f"{what}: expected one process, got {_processes()} by torchrun; start it without "
            "torchrun, which is for work that is shared (guide: sweeps)"
        )


def _processes() -> int:
    return int(os.environ.get("WORLD_SIZE", "1"))
