"""What a loop of training does besides its steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pcore.data.scene import View
from pcore.training.config import Background, FinetuneConfig, PretrainConfig
from pcore.training.exposure import ViewExposure
from pcore.training.gaussian_config import GaussianConfig, GaussianFinetuneConfig
from pcore.training.pace import Pace
from pcore.training.schedule import Schedule

Schedulable = PretrainConfig | FinetuneConfig | GaussianConfig | GaussianFinetuneConfig


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a loop does besides its steps.

    Attributes:
        steps: optimiser steps in all.
        rates: learning rates by the names of the optimiser's groups.
        validate_every: steps between validations.
        save_every: steps between saves.
        validation: held-out training views.
        validate_until: progress at which they are no longer held out: the last validation.
        background: behind images with alpha.
        scene: name of the scene, for the model file.
        pace: of a training that has promised a time; None makes the steps and no promise.
        exposure: of the photos, where it is learned along.
    """

    steps: int
    rates: Mapping[str, Schedule]
    validate_every: int
    save_every: int
    validation: Sequence[View]
    background: Background
    scene: str
    pace: Pace | None = None
    exposure: ViewExposure | None = None
    validate_until: float = 1.0

    @classmethod
    def of(
        cls,
        config: Schedulable,
        validation: Sequence[View],
        scene: str,
        *,
        rates: Mapping[str, Schedule] | None = None,
        pace: Pace | None = None,
        exposure: ViewExposure | None = None,
        validate_until: float = 1.0,
    ) -> Plan:
        """Take from settings what a loop needs of them; `rates` are more than those."""
        return cls(
            steps=config.steps,
            rates={**config.rates.named(), **(rates or {})},
            validate_every=config.validate_every,
            save_every=config.save_every,
            validation=validation,
            background=config.background,
            scene=scene,
            pace=pace,
            exposure=exposure,
            validate_until=validate_until,
        )
