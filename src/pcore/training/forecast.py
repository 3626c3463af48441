"""What a training of a scene will take and give, before it begins."""

from __future__ import annotations

import functools
import math
import time
from dataclasses import dataclass, replace
from typing import Literal

from pcore.data.images import DEFAULT_MEMORY_BUDGET
from pcore.data.scene import Scene
from pcore.errors import InputError, TrainingError
from pcore.geometry.camera import Camera
from pcore.training.config import PretrainConfig
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.measured_speed import measured_speed, papr_step, spreads
from pcore.training.presets import PretrainName, gaussian_preset, preset
from pcore.training.speed import Speed

_BASE_MEMORY, _PIXEL, _GAUSSIAN = 0.6e9, 16.0, 3.4e3
"""Bytes of a training without photos, of a pixel of a photo, and of a Gaussian with its gradient,
its moments and its part of the lists of tiles (resident bytes of 4,000 and of 300,000)."""
_PASSING = 1.25
"""Memory of a step over what its gradients keep (resident bytes at four sizes of PAPR)."""
_MORE = 1.15
"""A whole training over its steps: validation, saving and the light."""
_SMALL, _PROBE = 100, 32
"""Sides of the largest patch that is timed as it is, and of one that stands for larger ones."""
_TIMED, _SCALED = 1.3, 2.0
"""Within which factor a forecast holds: of steps as they will be, and of scaled ones or those of
points that start on a grid and spread (a phone's photos: from 1 to 2.9 times, 2.2 in the mean)."""
_FEWEST = 20
"""Training photos; all recorded trainings had more than twice as many."""
_LARGER = 1.5
"""Photos as much longer than recorded ones are another task."""

Model = Literal["gaussians", "papr"]


@dataclass(frozen=True, kw_only=True)
class _Record:
    """What trainings gave: docs/research/quality.md and docs/guide/training-time.md."""

    model: Model
    masked: bool
    side: int
    said: str


_RECORDS = (
    _Record(
        model="gaussians",
        masked=True,
        side=100,
        said="29 to 37 dB of the object, as five rendered scenes of 100 x 100 pixels had",
    ),
    _Record(
        model="gaussians",
        masked=True,
        side=200,
        said="27 dB of the object, as photos of a house of 200 x 150 pixels had",
    ),
    _Record(
        model="gaussians",
        masked=False,
        side=160,
        said="30 dB with the background, as a phone's photos of 90 x 160 pixels had",
    ),
    _Record(
        model="papr",
        masked=True,
        side=100,
        said="23 to 32 dB of the object, as five rendered scenes of 100 x 100 pixels had; photos "
        "of a house of 200 x 150 pixels had 14 to 17",
    ),
    _Record(
        model="papr",
        masked=False,
        side=160,
        said="7 to 13 dB with the background, as two sets of photos of 90 x 160 pixels had: take "
        "Gaussians, or masks",
    ),
)
"""All with the preset `tiny`; nobody trained the others to their ends here."""


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """One way to train a scene.

    Attributes:
        model: "gaussians" or "papr".
        preset: its settings.
        seconds: of one processor core; None where a training could not begin.
        within: the factor by which the seconds may be off.
        memory: bytes at the most; None where a training could not begin.
        quality: what to expect by what such trainings gave elsewhere, for people.
        how: how the time was predicted, for people.
    """

    model: Model
    preset: PretrainName
    seconds: float | None
    within: float
    memory: float | None
    quality: str
    how: str


def forecasts(scene: Scene) -> tuple[Forecast, ...]:
    """Predict trainings of a scene by every kind of object and preset on this machine.

    Args:
        scene: with its region; steps on a few of its training views are timed and thrown away.
    """
    masked = all(view.has_alpha for view in scene.split("train"))
    named: tuple[tuple[Model, PretrainName], ...] = (
        ("gaussians", "tiny"),
        ("gaussians", "fast"),
        ("papr", "tiny"),
        ("papr", "fast"),
        ("papr", "paper"),
    )

    @functools.cache
    def speed() -> Speed:
        # Presets differ in numbers of Gaussians and steps, and in rates: a step costs the same.
        return measured_speed(scene, gaussian_preset("tiny"), clock=time.process_time)

    found: list[Forecast] = []
    for model, name in named:
        quality = _quality(model, scene, masked=masked) if name == "tiny" else ""
        try:
            if model == "gaussians":
                one = gaussian_forecast(scene, gaussian_preset(name), speed())
            else:
                config = preset(name)
                one = papr_forecast(scene, config if masked else replace(config, start="grid"))
        except (InputError, TrainingError) as error:  # Masks are blamed for it elsewhere.
            one = Forecast(
                model=model,
                preset=name,
                seconds=None,
                within=1.0,
                memory=None,
                quality="",
                how=f"cannot begin: {error}",
            )
        found.append(replace(one, preset=name, quality=quality or "not recorded"))
    return tuple(found)


def gaussian_forecast(scene: Scene, config: GaussianConfig, speed: Speed) -> Forecast:
    """Predict a training of Gaussians; all its steps are taken to be with the largest number.

    Args:
        scene: its training views.
        config: its settings.
        speed: measured for these photos, in seconds of the processor.
    """
    camera = _largest(scene)
    seconds = speed.seconds(camera.width * camera.height, config.density.limit)
    return Forecast(
        model="gaussians",
        preset="tiny",
        seconds=_MORE * config.steps * seconds,
        within=_TIMED if config.density.limit <= gaussian_preset("tiny").density.limit else _SCALED,
        memory=_photo_memory(scene) + _GAUSSIAN * config.density.limit,
        quality="",
        how="a few steps at four sizes timed now",
    )


def papr_forecast(scene: Scene, config: PretrainConfig) -> Forecast:
    """Predict a training of PAPR, with the most points that it will have.

    A step of large patches is scaled from one of small patches: networks see every ray alone.

    Raises:
        InputError: the scene has no silhouettes for a visual hull.
    """
    camera, side = _largest(scene), config.patch.side
    scaled = side > _SMALL
    probed = _PROBE if scaled else side
    points = config.points if config.grow is None else config.grow.limit
    probe = replace(config, patch=replace(config.patch, side=probed, views=1), points=points)
    times = config.patch.views * _area(camera, side) / _area(camera, probed)
    cost = papr_step(scene, probe, clock=time.process_time)
    return Forecast(
        model="papr",
        preset="tiny",
        seconds=_MORE * config.steps * times * cost.seconds,
        within=_SCALED if scaled or spreads(config) else _TIMED,
        memory=_photo_memory(scene) + _PASSING * times * cost.memory,
        quality="",
        how="a few steps of a smaller patch timed now" if scaled else "a few steps timed now",
    )


def _quality(model: Model, scene: Scene, *, masked: bool) -> str:
    """What trainings of the most similar photos gave, and how that size is had."""
    camera, count = _largest(scene), len(scene.split("train"))
    if count < _FEWEST:
        return f"not recorded of so few photos ({count})"
    side = max(camera.width, camera.height)
    fitting = [one for one in _RECORDS if (one.model, one.masked) == (model, masked)]
    near = min(fitting, key=lambda one: abs(math.log(side / one.side)))
    if side < _LARGER * near.side:
        return near.said
    factor = scene.factor * round(side / near.side)
    return f"less than {near.said}; --factor {factor} is about that size"


def _largest(scene: Scene) -> Camera:
    cameras = (view.camera for view in scene.split("train"))
    return max(cameras, key=lambda one: one.width * one.height)


def _area(camera: Camera, side: int) -> int:
    """Pixels of a patch; photos that are smaller than it are taken whole."""
    return min(side, camera.width) * min(side, camera.height)


def _photo_memory(scene: Scene) -> float:
    pixels = sum(view.camera.width * view.camera.height for view in scene.split("train"))
    return _BASE_MEMORY + min(_PIXEL * pixels, DEFAULT_MEMORY_BUDGET)
