"""What a training does besides learning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


def _tell_nobody(text: str) -> None:
    """Say nothing."""


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """What a training does besides learning.

    Attributes:
        light: estimate the light of the photos at the end; where that is not possible the object
            has none, and `note` is told why.
        resume: go on exactly where the run in the folder was interrupted.
        tensorboard: write curves for TensorBoard into the folder, where its package is installed.
        compiled: use torch.compile where it pays, on a GPU.
        preset: what the settings are called in the record; None finds their name.
        note: told in a sentence where it goes on from, and what had to be left out.
    """

    light: bool = True
    resume: bool = False
    tensorboard: bool = False
    compiled: bool = True
    preset: str | None = None
    note: Callable[[str], None] = _tell_nobody
