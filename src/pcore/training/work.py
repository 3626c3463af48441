"""What the training loop asks of whatever is trained: networks with points, or Gaussians."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, TypeVar

import torch
from torch import Tensor

from pcore.data.scene import View
from pcore.files.run_folder import RunFolder
from pcore.files.training_state import TrainingState
from pcore.training.config import Background
from pcore.training.schedule import Schedule

Result = TypeVar("Result", covariant=True)


class Work(Protocol[Result]):
    """The working state of a training.

    Attributes:
        stage: "pretrain" or "finetune".
        step: steps done.
        optimizer: has one group with a `name` per learning rate.
        best: figures of the best validation, and its weights where they are kept.
        origin: (3,) float64 what its places count from, world units; None: they are the world's.
    """

    stage: str
    step: int
    optimizer: torch.optim.Optimizer
    best: dict[str, Any]
    origin: Tensor | None

    @property
    def points(self) -> int:
        """How many points or Gaussians there are."""
        ...

    def weights(self) -> dict[str, Tensor]:
        """All weights by name, sharing memory with the training."""
        ...

    def set_rates(self, rates: Mapping[str, Schedule], steps: float) -> None:
        """Set the learning rate of every group, by its name, for the coming step."""
        ...

    def result(self, weights: Mapping[str, Tensor] | None = None) -> Result:
        """What to hand over: of `weights`, or as it is."""
        ...

    def scores(
        self,
        views: Sequence[View],
        background: Background,
        weights: Mapping[str, Tensor] | None = None,
    ) -> dict[str, float]:
        """Figures on held-out training views over the background, of `weights` or as it is."""
        ...

    def state(self) -> TrainingState:
        """What `restore` needs to go on exactly."""
        ...

    def restore(self, state: TrainingState) -> None:
        """Put this into a saved state, exactly."""
        ...

    def save(self, folder: RunFolder, scene: str) -> list[str]:
        """Write what users load of the result; return the paths."""
        ...
