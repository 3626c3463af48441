"""Settings of a training that takes so many seconds of the processor on this machine."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from pcore.files.run_record import RunRecord
from pcore.training.config import PretrainConfig
from pcore.training.gaussian_config import GaussianConfig

Settings = TypeVar("Settings", GaussianConfig, PretrainConfig)

_TIMED, _WARM = 40, 2
"""Steps that are timed, and those before."""
_LEAST, MOST = 200, 30_000
"""Steps of a training."""


def with_seconds(config: Settings, seconds: float, fit: Callable[[Settings], object]) -> Settings:
    """Settings with as many steps as fit into a time, measured on a few.

    Args:
        config: all but the steps.
        seconds: of the processor, for the steps and what every training takes once.
        fit: trains with settings.
    """
    fit(_brief(config, _WARM))  # Kernels are compiled once.
    spent: list[float] = []
    for steps in (_WARM, _WARM + _TIMED):
        begin = time.process_time()
        fit(_brief(config, steps))
        spent.append(time.process_time() - begin)
    # What a training takes besides its steps is in both.
    step = max(spent[1] - spent[0], 1e-3) / _TIMED
    once = max(spent[0] - _WARM * step, 0.0)
    return _with_steps(config, int(min(max((seconds - once) / step, _LEAST), MOST)))


def as_begun(config: Settings, run: Path, stage: str) -> Settings:
    """Settings with what a training that was killed asked for: another pace would be another one.

    Args:
        config: all else.
        run: its folder.
        stage: the name that its record has for its settings.
    """
    stored = RunRecord.read(run).config[stage]
    return replace(_with_steps(config, stored["steps"]), points=stored["points"])


def _with_steps(config: Settings, steps: int) -> Settings:
    quarter = max(1, steps // 4)
    return replace(config, steps=steps, validate_every=quarter, save_every=quarter)


def _brief(config: Settings, steps: int) -> Settings:
    return replace(config, steps=steps, validate_every=MOST, save_every=MOST)
