"""`pcore train --minutes N`: settings from a promise of time, and how long a training will take."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.cli.train import TrainCommand
    from pcore.data.scene import Scene
    from pcore.training.gaussian_config import GaussianConfig
    from pcore.training.speed import Speed

_LIGHT_STEPS = 2.0
"""What the estimate of the light costs, in steps per view at the finest size."""
_LIGHT_FIXED = 8.0
"""And in seconds besides."""
_WORTH_MEASURING = 200
"""Trainings of fewer steps are over before they are measured."""
_CHOSEN = ("steps", "points", "density", "levels", "seconds")
"""Settings of Gaussians that a promise decides on."""


@dataclass(frozen=True, kw_only=True)
class Promise:
    """Minutes that a command has, and when it began.

    Attributes:
        minutes: in all.
        began: by `time.monotonic`.
    """

    minutes: float
    began: float

    @property
    def seconds_left(self) -> float:
        """Until the end of the promise."""
        return 60 * self.minutes - (time.monotonic() - self.began)


def promised(
    command: TrainCommand, scene: Scene, base: GaussianConfig, device: str, promise: Promise
) -> tuple[Scene, GaussianConfig, str]:
    """Settings and photos for a promise, and the plan in words; of the run itself to go on.

    Raises:
        InputError: an option that the promise decides on, or too little time.
    """
    from pcore.capture.load import load_scene
    from pcore.files.run_record import RunRecord, begun
    from pcore.training.measured_speed import measured_speed, photos_of
    from pcore.training.time_plan import plan_gaussians

    _check(command)
    if command.resume and begun(command.output):
        config = RunRecord.read(command.output).config
        scene = load_scene(command.scene, factor=int(config.get("factor", 1)))
        return scene, recorded(config.get("gaussians"), base, command), "as the run was planned"
    photos = photos_of(scene)
    speed = measured_speed(scene, base, device)
    given = 1 if command.factor > 1 else None
    plan = plan_gaussians(photos, speed, promise.seconds_left, base, factor=given)
    # Once more, since the estimate of the light depends on what was chosen.
    reserve = after_training(photos.pixels(plan.factor), photos.count, plan.gaussians, speed)
    plan = plan_gaussians(photos, speed, promise.seconds_left - reserve, base, factor=plan.factor)
    if plan.factor > 1:
        scene = load_scene(command.scene, factor=plan.factor)
    return scene, plan.gaussians, in_words(scene, plan.gaussians, promise.minutes)


def recorded(settings: Any, base: GaussianConfig, command: TrainCommand) -> GaussianConfig:
    """What was planned when the run began, with the options of today for all else.

    Raises:
        InputError: the run was no promise, or of PAPR.
    """
    from pcore.files.records import from_dict
    from pcore.training.gaussian_config import GaussianConfig

    if not isinstance(settings, dict) or settings.get("seconds") is None:
        raise InputError(
            f"{command.output}: --minutes {command.minutes:g}: expected a run that began with "
            "--minutes, got one that did not; resume it without that option"
        )
    config = from_dict(GaussianConfig, settings, where=f"{command.output}: run.json")
    return replace(base, **{name: getattr(config, name) for name in _CHOSEN})


def after_training(pixels: float, views: int, config: GaussianConfig, speed: Speed) -> float:
    """Seconds that a command takes after the last step: the light of the photos."""
    return _LIGHT_FIXED + _LIGHT_STEPS * views * speed.seconds(pixels, config.density.limit)


def in_words(scene: Scene, config: GaussianConfig, minutes: float) -> str:
    """The plan in one sentence."""
    camera = scene.split("train")[0].camera
    sizes = [level.reduction for level in config.levels or ()]
    coarse = ""
    if sizes:
        width, height = round(camera.width / sizes[0]), round(camera.height / sizes[0])
        coarse = f"from {width} x {height} up to "
    return (
        f"{minutes:g} minutes: photos {coarse}{camera.width} x {camera.height}, "
        f"{config.points:,} to {config.density.limit:,} Gaussians, about {config.steps:,} steps; "
        "the number of steps follows the clock"
    )


def say_duration(console: Console, scene: Scene, config: GaussianConfig, device: str) -> None:
    """Say how long a training without a promise will take on this machine."""
    from pcore.cli.console import clock
    from pcore.training.measured_speed import measured_speed

    if config.steps < _WORTH_MEASURING:
        return
    views = scene.split("train")
    pixels = max(view.camera.width * view.camera.height for view in views)
    speed = measured_speed(scene, config, device)
    seconds = config.steps * speed.seconds(pixels, config.density.limit)
    seconds += after_training(pixels, len(views), config, speed)
    console.print(
        Text(f"about {clock(seconds)} on this machine, as busy as it is now"), soft_wrap=True
    )


def _check(command: TrainCommand) -> None:
    minutes = command.minutes
    if minutes is None or not 0 < minutes < 10_000:
        raise InputError(f"--minutes {minutes}: expected a number above 0 and below 10,000")
    given = [name for name in ("steps", "points") if getattr(command, name) is not None]
    if given:
        raise InputError(
            f"--minutes {minutes:g} chooses {' and '.join(given)}: expected no such option beside "
            f"it, got --{given[0]}; leave one of them out"
        )
