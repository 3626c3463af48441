"""What a training of a scene will take and give, before it begins."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from pcore.data.images import DEFAULT_MEMORY_BUDGET
from pcore.data.scene import Scene
from pcore.errors import InputError, TrainingError
from pcore.training.config import PretrainConfig
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.measured_speed import measured_speed, papr_step_seconds
from pcore.training.presets import gaussian_preset, preset

_BASE_MEMORY, _PIXEL = 0.7e9, 16.0
"""Bytes of a training of 10,000 Gaussians without photos, and of a pixel of a photo."""
_MORE = 1.15
"""A whole training over its steps: validation, saving and the light."""
_QUALITY = {
    ("gaussians", True): "29 to 37 dB of the object on rendered scenes of 100 x 100, 27 on photos",
    ("gaussians", False): "not recorded; the background counts too",
    ("papr", True): "23 to 32 dB of the object on rendered scenes of 100 x 100",
    ("papr", False): "17 to 20 dB after short trainings: prefer Gaussians",
}
"""By kind of object and whether there are masks: docs/research/quality.md, and own captures."""


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """One way to train a scene.

    Attributes:
        model: "gaussians" or "papr".
        preset: its settings.
        seconds: of one processor core; None where nothing is known.
        memory: bytes at the most; None where nothing is known.
        quality: what such trainings gave elsewhere, for people.
        how: how the time was predicted, for people.
    """

    model: str
    preset: str
    seconds: float | None
    memory: float | None
    quality: str
    how: str


def forecasts(scene: Scene) -> tuple[Forecast, ...]:
    """Predict trainings of a scene by every kind of object and preset on this machine.

    Args:
        scene: with its region; steps on a few of its training views are timed and thrown away.
    """
    views = scene.split("train")
    masked = all(view.has_alpha for view in views)
    photos = sum(view.camera.width * view.camera.height for view in views) * _PIXEL
    memory = _BASE_MEMORY + min(photos, DEFAULT_MEMORY_BUDGET)
    camera = max((v.camera for v in views), key=lambda one: one.width * one.height)
    size = f"{camera.width} x {camera.height} pixels"
    timed = f"a few steps on photos of {size} timed now, in processor seconds"
    unknown = "for a GPU; nothing was measured on one"
    return (
        Forecast(
            model="gaussians",
            preset="tiny",
            seconds=_seconds(lambda: _gaussian_seconds(scene, gaussian_preset("tiny"))),
            memory=memory,
            quality=_QUALITY["gaussians", masked],
            how=timed,
        ),
        Forecast(
            model="papr",
            preset="tiny",
            seconds=_seconds(lambda: _papr_seconds(scene, preset("tiny"), masked=masked)),
            memory=memory,
            quality=_QUALITY["papr", masked],
            how=timed,
        ),
        Forecast(
            model="gaussians", preset="fast", seconds=None, memory=None, quality="", how=unknown
        ),
        Forecast(
            model="papr", preset="fast, paper", seconds=None, memory=None, quality="", how=unknown
        ),
    )


def _seconds(measure: Callable[[], float]) -> float | None:
    """What is measured; None where a training could not even begin, which masks are blamed for."""
    try:
        return measure()
    except (InputError, TrainingError):
        return None


def _gaussian_seconds(scene: Scene, config: GaussianConfig) -> float:
    """Processor seconds; a third of the steps is done with fewer Gaussians than in the end."""
    pixels = max(view.camera.width * view.camera.height for view in scene.split("train"))
    speed = measured_speed(scene, config, clock=time.process_time)
    return _MORE * config.steps * speed.seconds(pixels, config.density.limit)


def _papr_seconds(scene: Scene, config: PretrainConfig, *, masked: bool) -> float:
    started = config if masked else replace(config, start="grid")
    return _MORE * config.steps * papr_step_seconds(scene, started, clock=time.process_time)
