"""Several processes that share work: parts of every batch of a training, or pictures."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, TypeVar

import torch
import torch.distributed as dist
from torch import Tensor

from pcore.errors import InputError, TrainingError

Item = TypeVar("Item")

_alone: ContextVar[bool] = ContextVar("alone", default=False)


@dataclass(frozen=True, kw_only=True)
class Ranks:
    """This process among those that work together; one alone by default.

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
                f"{self.count} processes: expected at least as many patches or photos in a step, "
                f"got {len(batch)}; give --patches {self.count} or a multiple"
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

    def in_turn(self, count: int, make: Callable[[int], Item]) -> Iterator[Item]:
        """Make items 0 to count - 1, each in one of the processes.

        Returns:
            In the first process all of them, in order; in the others none, and to go through it is
            their work.
        """
        if self.count == 1:
            yield from map(make, range(count))
            return
        for start in range(0, count, self.count):
            own = start + self.rank
            made = make(own) if own < count else None
            box: list[Any] | None = [None] * self.count if self.rank == 0 else None
            dist.gather_object(made, box)
            yield from (box or [])[: count - start]

    def agree(self, values: Mapping[str, object]) -> None:
        """Check that processes which begin to work together were given the same.

        Args:
            values: by what they are called; tensors by their bits, others by their `repr`.

        Raises:
            InputError: in all of them, where one has another value.
        """
        if self.count == 1:
            return
        own = {
            name: _digest(value).hex() if isinstance(value, Tensor) else repr(value)
            for name, value in values.items()
        }
        told: list[Any] = [None] * self.count
        dist.all_gather_object(told, own)
        for rank, other in enumerate(told):
            bad = [name for name in told[0] if other.get(name) != told[0][name]]
            if bad:
                raise InputError(
                    f"{self.count} processes: expected the same {' and '.join(bad)} in all of "
                    f"them, got others in process {rank} than in process 0; give every machine "
                    "the same command, the same files and the same version of pcore"
                )

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


@contextmanager
def by_itself() -> Generator[None]:
    """Let this process do all of what it does inside, while others do something else."""
    token = _alone.set(True)
    try:
        yield
    finally:
        _alone.reset(token)


def current_ranks() -> Ranks:
    """This process among those of torch's process group; alone where there is none."""
    if _alone.get() or not (dist.is_available() and dist.is_initialized()):
        return Ranks()
    return Ranks(rank=dist.get_rank(), count=dist.get_world_size())


def _digest(tensor: Tensor) -> bytes:
    return hashlib.blake2b(tensor.detach().cpu().contiguous().numpy().tobytes()).digest()
