"""What the heavy verbs do before they begin: device, threads, memory."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from pcore.training.ranks import Ranks

DeviceName = Literal["auto", "cpu", "cuda"]


def prepare_torch(threads: int | None = None) -> None:
    """Set this process up for heavy work; call it once, before large tensors are made.

    Args:
        threads: of torch and of the kernels; None leaves torch's choice.

    Raises:
        InputError: fewer than one thread.
    """
    import torch

    from pcore.kernels.memory import keep_freed_memory
    from pcore.validation import check_count

    if threads is not None:
        torch.set_num_threads(check_count("--threads", threads))
    keep_freed_memory()
    # Vanishing weights of the softmax and Adam's moments would be computed in slow motion.
    torch.set_flush_denormal(True)


def pick_device(name: DeviceName) -> str:
    """Return the device to compute on: "cuda" or "cpu"; auto takes a GPU where there is one.

    Raises:
        InputError: a GPU was asked for and torch finds none.
    """
    import torch

    from pcore.errors import InputError

    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        why = (
            "this torch was built for the CPU only; install one with CUDA"
            if torch.version.cuda is None
            else "check the driver"
        )
        raise InputError(
            f"--device cuda: expected a GPU that torch {torch.__version__} can use, found none: "
            f"{why}, or use --device cpu"
        )
    return name


@contextmanager
def joined_ranks(device: str) -> Generator[Ranks]:
    """Train together with the other processes that torchrun started; alone without it.

    Args:
        device: "cuda": each process takes the GPU of its number on its machine; or "cpu".
    """
    import torch
    import torch.distributed as dist

    from pcore.training.ranks import Ranks, current_ranks

    if _processes() < 2:
        yield Ranks()
        return
    if device == "cuda":
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
    dist.init_process_group("nccl" if device == "cuda" else "gloo")
    try:
        yield current_ranks()
    finally:
        dist.destroy_process_group()


def is_first() -> bool:
    """Whether this process speaks for those that torchrun started; it does alone."""
    return _processes() < 2 or os.environ.get("RANK", "0") == "0"


def refuse_ranks(what: str) -> None:
    """Refuse to do the same work several times.

    Raises:
        InputError: torchrun started several processes.
    """
    from pcore.errors import InputError

    if _processes() > 1:
        raise InputError(
            f"{what}: expected one process, got {_processes()} by torchrun; only `pcore train "
            "--model papr` shares its work, start this one without torchrun"
        )


def _processes() -> int:
    return int(os.environ.get("WORLD_SIZE", "1"))
