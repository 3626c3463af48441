"""`pcore train --minutes N`: settings from a promise of time, and how long a training will take."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from rich.console import Console

from pcore.cli.console import clock, say
from pcore.cli.scenes import opened
from pcore.cli.train import TrainCommand
from pcore.data.scene import Scene
from pcore.errors import InputError
from pcore.files.records import from_dict
from pcore.files.run_place import saved_nothing
from pcore.files.run_record import RunRecord, begun
from pcore.training.config import PretrainConfig
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.measured_speed import measured_speed, papr_step, photos_of
from pcore.training.speed import Speed
from pcore.training.time_plan import ShortPromiseError, TimePlan, plan_gaussians, plan_papr

Config = TypeVar("Config", bound=GaussianConfig | PretrainConfig)

_LIGHT_STEPS = 2.0
"""What the estimate of the light costs, in steps per view at the finest size."""
_LIGHT_FIXED = 8.0
"""And in seconds besides."""
_SURFACE_STEPS = 1.0
"""What the surface over PAPR's points costs, in steps per patch of the photos."""
_WORTH_MEASURING = 200
"""Trainings of fewer steps are over before they are measured."""
_MARGIN = 1.2
"""What is told to be needed, over what was measured: the next measurement is another one."""
_OF_PAPR = ("steps", "points", "levels", "seconds")
_OF_GAUSSIANS = (*_OF_PAPR, "density")
"""Settings that a promise decides on."""


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
    command: TrainCommand, scene: Scene, base: Config, device: str, promise: Promise
) -> tuple[Scene, Config, str]:
    """Photos and settings for a promise, and the plan in words; of the run itself to go on."""
    if command.resume:
        going = _recorded(command, base)
        if going is not None:
            return *going, "as the run was planned"
    planner = _planner(scene, base, device)
    factor = 1 if command.factor > 1 else None
    try:
        plan = planner.plan(promise.seconds_left, factor)
        # Once more, since what comes after the last step depends on what was chosen.
        plan = planner.plan(_left(promise, planner.after(plan)), plan.factor)
    except ShortPromiseError as problem:
        least = _least_minutes(planner, factor, problem.needed, promise)
        raise InputError(f"{problem}: about {least:.1f}") from problem
    scene = _divided(command, scene, plan.factor)
    return scene, plan.config, _in_words(scene, plan.config, promise)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Planner:
    """Plans for seconds and a division of the photos, and seconds that follow one."""

    plan: Callable[[float, int | None], TimePlan[Any]]
    after: Callable[[TimePlan[Any]], float]


def _planner(scene: Scene, base: GaussianConfig | PretrainConfig, device: str) -> _Planner:
    photos = photos_of(scene)
    if isinstance(base, PretrainConfig):
        step = papr_step(scene, base, device).seconds
        return _Planner(
            plan=lambda seconds, factor: plan_papr(photos, step, seconds, base, factor=factor),
            after=lambda plan: after_papr(photos.pixels(plan.factor), photos.count, base, step),
        )
    speed = measured_speed(scene, base, device)
    return _Planner(
        plan=lambda seconds, factor: plan_gaussians(photos, speed, seconds, base, factor=factor),
        after=lambda plan: after_gaussians(
            photos.pixels(plan.factor), photos.count, plan.config, speed
        ),
    )


def _recorded(command: TrainCommand, base: Config) -> tuple[Scene, Config] | None:
    """What was planned when the run began, with today's options for all else; None: nothing was."""
    if not begun(command.output) or saved_nothing(command.output):
        return None
    record = RunRecord.read(command.output).config
    papr = isinstance(base, PretrainConfig)
    settings: Any = record.get("pretrain" if papr else "gaussians")
    if not isinstance(settings, dict) or settings.get("seconds") is None:
        raise InputError(
            f"{command.output}: --minutes {command.minutes:g}: expected a run of this kind that "
            "began with --minutes, got another; resume it with the options that it began with"
        )
    config = from_dict(type(base), settings, where=f"{command.output}: run.json")
    names = _OF_PAPR if papr else _OF_GAUSSIANS
    changed = replace(base, **{name: getattr(config, name) for name in names})
    again = replace(command, factor=int(record.get("factor", 1)))
    return opened(again, Console(quiet=True)), changed


def _divided(command: TrainCommand, scene: Scene, factor: int) -> Scene:
    if factor == 1:
        return scene
    # Masks that were cut for this run lie in its folder by now.
    return opened(replace(command, factor=factor), Console(quiet=True))


def _left(promise: Promise, reserve: float) -> float:
    """Seconds for the training itself; a tenth of what is left at least, which is then too much."""
    left = promise.seconds_left
    return max(left - reserve, 0.1 * left, 1.0)


def _least_minutes(planner: _Planner, factor: int | None, needed: float, promise: Promise) -> float:
    """Minutes of a promise that leaves so many seconds for the training itself, and some more."""
    needed *= _MARGIN
    gone = 60 * promise.minutes - promise.seconds_left
    after = planner.after(planner.plan(needed, factor))
    # As `_left` has it: a tenth of what is left is always the training's.
    return (gone + min(needed + after, 10 * needed)) / 60


def _in_words(scene: Scene, config: GaussianConfig | PretrainConfig, promise: Promise) -> str:
    """The plan in one sentence."""
    what = f"{config.points:,} points"
    if not isinstance(config, PretrainConfig):
        what = f"{config.points:,} to {config.density.limit:,} Gaussians"
    camera = scene.split("train")[0].camera
    coarse = ""
    if config.levels:
        first = config.levels[0].reduction
        coarse = f"from {round(camera.width / first)} x {round(camera.height / first)} up to "
    return (
        f"{promise.minutes:g} minutes: photos {coarse}{camera.width} x {camera.height}, {what}, "
        f"about {config.steps:,} steps; the number of steps follows the clock"
    )


def after_gaussians(pixels: float, views: int, config: GaussianConfig, speed: Speed) -> float:
    """Seconds that a command takes after the last step: the light of the photos."""
    return _LIGHT_FIXED + _LIGHT_STEPS * views * speed.seconds(pixels, config.density.limit)


def after_papr(pixels: float, views: int, config: PretrainConfig, step: float) -> float:
    """The same for PAPR, which also looks for its surface in all views."""
    patch = config.patch.views * config.patch.side**2
    return _LIGHT_FIXED + _SURFACE_STEPS * views * step * pixels / patch


def say_duration(
    console: Console, scene: Scene, config: GaussianConfig | PretrainConfig, device: str
) -> None:
    """Say how long a training without a promise will take on this machine."""
    if config.steps < _WORTH_MEASURING:
        return
    views = scene.split("train")
    pixels = max(view.camera.width * view.camera.height for view in views)
    if isinstance(config, PretrainConfig):
        step = papr_step(scene, config, device).seconds
        seconds = config.steps * step + after_papr(pixels, len(views), config, step)
    else:
        speed = measured_speed(scene, config, device)
        seconds = config.steps * speed.seconds(pixels, config.density.limit)
        seconds += after_gaussians(pixels, len(views), config, speed)
    say(console, f"about {clock(seconds)} on this machine, as busy as it is now")


def check_promise(command: TrainCommand) -> None:
    """Raise InputError for a promise that cannot be meant, or options that it chooses itself."""
    minutes = command.minutes
    if minutes is None:
        return
    if not 0 < minutes < 10_000:
        raise InputError(f"--minutes {minutes}: expected a number above 0 and below 10,000")
    given = [name for name in ("steps", "points") if getattr(command, name) is not None]
    if given:
        raise InputError(
            f"--minutes {minutes:g} chooses {' and '.join(given)}: expected no such option beside "
            f"it, got --{given[0]}; leave one of them out"
        )
