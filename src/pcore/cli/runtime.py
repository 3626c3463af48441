"""What the heavy verbs do before they begin: device, threads, memory."""

from __future__ import annotations

from typing import Literal

DeviceName = Literal["auto", "cpu", "cuda"]


def prepare_torch(threads: int | None = None) -> None:
    """Set this process up for heavy work; call it once, before large tensors are made.

    Args:
        threads: of torch and of the kernels; None leaves torch's choice.
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
    """Return the device to compute on: "cuda" or "cpu"; auto takes a GPU where there is one."""
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
