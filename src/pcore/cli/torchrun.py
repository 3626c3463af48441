"""`torchrun ... pcore VERB`: several processes share the work of a verb; alone without torchrun."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console

if TYPE_CHECKING:
    from pcore.asset.asset import Asset
    from pcore.cli.train import TrainCommand
    from pcore.data.scene import Scene
    from pcore.training.config import PretrainConfig
    from pcore.training.gaussian_config import GaussianConfig
    from pcore.training.ranks import Ranks


def trained_together(
    command: TrainCommand,
    scene: Scene,
    config: PretrainConfig | GaussianConfig,
    device: str,
    console: Console,
) -> Asset | None:
    """Train; only the first process has the folder and the result, the others get None.

    Raises:
        InputError: processes that were given different settings or photos.
    """
    from pcore.asset.training import RunOptions, train
    from pcore.cli.train import trained
    from pcore.files.provenance import pcore_version
    from pcore.files.run_record import finished

    with joined_ranks(device) as ranks:
        views = [
            (view.name, view.camera.width, view.camera.height) for view in scene.split("train")
        ]
        ranks.agree({"version of pcore": pcore_version(), "settings": config, "photos": views})
        done = ranks.from_first(command.resume and finished(command.output))
        if ranks.rank == 0:
            return trained(command, scene, config, device, console)
        if not done:
            options = RunOptions(light=False, compiled=not command.no_compile)
            train(scene, config, device=device, options=options)
    return None


@contextmanager
def joined_ranks(device: str, *, learns: bool = True) -> Generator[Ranks]:
    """Work together with the other processes that torchrun started; alone without it.

    Args:
        device: "cuda": each process takes the GPU of its number on its machine; or "cpu".
        learns: gradients are exchanged, GPU to GPU; else finished work is, on the CPU.
    """
    import torch
    import torch.distributed as dist

    from pcore.training.ranks import Ranks, current_ranks

    if _processes() < 2:
        yield Ranks()
        return
    if device == "cuda":
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
    dist.init_process_group("nccl" if device == "cuda" and learns else "gloo")
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
            f"{what}: expected one process, got {_processes()} by torchrun; `pcore train`, "
            "`render`, `animate` and `eval` share their work, start this one without torchrun"
        )


def _processes() -> int:
    return int(os.environ.get("WORLD_SIZE", "1"))
