"""torch.compile for the networks that no kernel of ours serves: the renderer and LPIPS.

Their inputs are patches of one size, whatever the number of points, so they are compiled once and
pruning and growing change nothing. Compiling is done in place: the names of weights stay.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

import torch
from torch import nn

from pcore.errors import TrainingError

BACKEND = "inductor"


def is_worth_compiling(device: torch.device) -> bool:
    """Whether compiled networks are faster there; on the CPU it takes a minute and gains little."""
    return device.type == "cuda"


def compile_networks(device: torch.device, *networks: object) -> None:
    """Compile networks on a GPU at their first call; what is no network is left alone.

    Whole: what cannot be compiled, or has more sizes of patches than are compiled, is an error and
    not silently slow.
    """
    if is_worth_compiling(device):
        for network in networks:
            if isinstance(network, nn.Module):
                network.compile(fullgraph=True, backend=BACKEND)


@contextmanager
def compiler_errors_explained() -> Generator[None]:
    """Turn what the compiler raises into a TrainingError that says how to do without it."""
    try:
        yield
    except RuntimeError as error:
        # Known by name: importing the compiler takes seconds, also where it is not used.
        if all(one.__name__ != "TorchDynamoException" for one in type(error).__mro__):
            raise
        raise TrainingError(
            f"torch.compile: expected networks that it can compile on this machine, got "
            f"{type(error).__name__} ({str(error).strip().splitlines()[0]}); go on with "
            "--no-compile, or with TORCHDYNAMO_DISABLE=1 in the environment: slower, and the same"
        ) from error
