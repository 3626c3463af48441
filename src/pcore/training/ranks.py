"""Several processes that train one object: each draws a part of every batch."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import torch
import torch.distributed as dist
from torch import Tensor

from pcore.errors import InputError, TrainingError

Item = TypeVar("Item")


@dataclass(frozen=True, kw_only=True)
class Ranks:
    """This process among those that train together; one alone by default.

    Attributes:
        rank: which it is; 0 saves and reports.
        count: of processes.
    """

    rank: int = 0
    count: int = 1

    def share(self, batch: Sequence[Item]) -> Sequence[Item]:
        """What this process has to do of a batch that all have drawn alike.

        Raises:
            InputError: there is nothing for some process.
        """
        if len(batch) < self.count:
            raise InputError(
                f"{self.count} processes: expected at least as many patches in a step, got "
                f"{len(batch)}; give --patches {self.count} or a multiple"
            )
        return batch[self.rank :: self.count]

    def add(self, tensors: Iterable[Tensor]) -> None:
        """Replace tensors of the same shapes in all processes by their sums, all in one message."""
        if self.count == 1:
            return
        own = [*tensors]
        flat = torch.cat([one.reshape(-1) for one in own])
        dist.all_reduce(flat)
        parts = flat.split([one.numel() for one in own])
        for one, part in zip(own, parts, strict=True):
            one.copy_(part.view_as(one))

    def add_gradients(self, parameters: Iterable[Tensor]) -> None:
        """Replace all gradients by their sums over the processes."""
        if self.count == 1:
            return
        learned = [p for p in parameters if p.requires_grad]
        for p in learned:
            # Whether a parameter took part may differ between processes, the message may not.
            p.grad = torch.zeros_like(p) if p.grad is None else p.grad
        self.add([p.grad for p in learned if p.grad is not None])

    def any(self, here: bool) -> bool:
        """Whether something holds in at least one process."""
        if self.count == 1:
            return here
        told = torch.tensor([float(here)], device=self._device())
        dist.all_reduce(told)
        return bool(told > 0)

    def from_first(self, value: Item) -> Item:
        """What the first process has, in all of them."""
        if self.count == 1:
            return value
        box = [value]
        dist.broadcast_object_list(box, src=0)
        return box[0]

    def check_same(self, weights: Mapping[str, Tensor], step: int) -> None:
        """Compare the weights of all processes bit by bit.

        Raises:
            TrainingError: in all of them, where one has other weights.
        """
        if self.count == 1:
            return
        own = {name: _digest(tensor) for name, tensor in weights.items()}
        first = self.from_first(own)
        bad = [name for name in own if first.get(name) != own[name]]
        if self.any(bool(bad)):
            raise TrainingError(
                f"step {step}: expected the same weights in all {self.count} processes, got other "
                f"ones ({', '.join(bad[:3]) or 'elsewhere'}); what was saved before is untouched. "
                "Use machines of one kind and the same versions everywhere"
            )

    def _device(self) -> str:
        return "cuda" if dist.get_backend() == "nccl" else "cpu"


def current_ranks() -> Ranks:
    """This process among those of torch's process group; alone where there is none."""
    if not (dist.is_available() and dist.is_initialized()):
        return Ranks()
    return Ranks(rank=dist.get_rank(), count=dist.get_world_size())


def _digest(tensor: Tensor) -> bytes:
    return hashlib.blake2b(tensor.detach().cpu().contiguous().numpy().tobytes()).digest()
