"""How far a training is in its schedule: by a number of steps, or by a promise of time.

Progress runs from 0 to 1. Learning rates, resolutions and populations follow it, so that a machine
that turns out slower or faster than it was measured changes how many steps a schedule has, and
nothing else about it. With a number of steps progress is the share that is done.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.training.loop_plan import Plan, Schedulable

Clock = Callable[[], float]
"""Seconds since any moment."""

_WINDOWS = 60
"""So many times in all a promise is looked at."""
_TRUST = 0.4
"""Weight of the last window in what a step is thought to cost."""
_JUMP = 4.0
"""A window that looks dearer or cheaper by more than this counts as this: a machine that slept."""
_FIRST_SAVE, _SAVES = 90.0, 6
"""Seconds after which a promised training saves at the latest, and how often in all."""


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A part of a schedule whose steps cost the same.

    Attributes:
        end: progress at which it ends; 1 of the last one.
        cost: of a step beside the steps of other legs.
    """

    end: float
    cost: float


def work_left(progress: float, legs: Sequence[Leg]) -> float:
    """Cost of the schedule from here to its end, if progress were one step."""
    total, begin = 0.0, 0.0
    for leg in legs:
        total += leg.cost * max(0.0, leg.end - max(progress, begin))
        begin = leg.end
    return total


def stride(progress: float, seconds: float, unit: float, legs: Sequence[Leg]) -> float:
    """Progress of one step so that the rest of a schedule takes the seconds that are left.

    Args:
        progress: now.
        seconds: that are left; none ends the schedule with the next step.
        unit: seconds that a step of cost 1 takes.
        legs: of the schedule.
    """
    rest = 1.0 - progress
    if seconds <= 0:
        return rest
    return min(rest, unit * work_left(progress, legs) / seconds)


class Pace:
    """Progress of one training through its schedule, and when it validates and saves."""

    def __init__(
        self,
        steps: int,
        *,
        validate_every: int = 1,
        save_every: int = 1,
        seconds: float | None = None,
        legs: Sequence[Leg] = (),
        clock: Clock = time.monotonic,
    ) -> None:
        """Begin at progress 0.

        Args:
            steps: in all; as foreseen, with a promise.
            validate_every: steps between validations; with a promise the times of saves count.
            save_every: steps between saves, without a promise.
            seconds: promised for all steps, validations and saves; None goes by steps alone.
            legs: what steps cost in the parts of the schedule; none is one part.
            clock: tells the time.
        """
        if seconds is not None and not (math.isfinite(seconds) and seconds > 0):
            raise InputError(f"pace: expected a finite time above 0, got {seconds} seconds")
        self.steps = steps
        """In all, as far as is known now."""
        self.spent = 0.0
        """Seconds that earlier processes of this training took."""
        self._every = (validate_every, save_every)
        self._seconds, self._clock = seconds, clock
        self._legs = tuple(legs) or (Leg(end=1.0, cost=1.0),)
        self._anchor = (0, 0.0, 1.0 / steps)  # Step and progress, and progress per step since.
        self._unit = 0.0 if seconds is None else seconds / (steps * work_left(0.0, self._legs))
        self._began = self._window = clock()
        self._save_at = 0.0 if seconds is None else min(_FIRST_SAVE, seconds / _SAVES)
        self._due = False
        self._first = 0  # Steps of other processes.

    @classmethod
    def of(
        cls,
        config: Schedulable | Plan,
        *,
        seconds: float | None = None,
        legs: Sequence[Leg] = (),
        clock: Clock = time.monotonic,
    ) -> Pace:
        """Make the pace of settings; the other arguments are those of a `Pace`."""
        every = {"validate_every": config.validate_every, "save_every": config.save_every}
        return cls(config.steps, **every, seconds=seconds, legs=legs, clock=clock)

    @property
    def elapsed(self) -> float:
        """Seconds that this training has taken, in all its processes."""
        return self.spent + self._clock() - self._began

    def progress(self, step: int) -> float:
        """Progress before a step, from 0 to 1."""
        if self._seconds is None:
            return step / self.steps
        first, before, per_step = self._anchor
        return min(1.0, before + per_step * (step - first))

    def length(self, step: int) -> float:
        """Steps of a training of which so many steps are this progress: what schedules count in."""
        progress = self.progress(step)
        return self.steps if self._seconds is None or progress == 0 else step / progress

    def done(self, step: int) -> bool:
        """Whether there are no more steps."""
        return step >= self.steps

    def after(self, step: int) -> None:
        """Look at the time after a step, where that is due; `steps` may change."""
        if self._seconds is None or self.done(step):
            return
        now = self.elapsed
        self._due = now >= self._save_at
        if self._due:
            self._save_at = now + self._seconds / _SAVES
        first, before, _ = self._anchor
        if step - first < max(5, self.steps // _WINDOWS):
            return
        progress = self.progress(step)
        took = self._clock() - self._window
        cost = work_left(before, self._legs) - work_left(progress, self._legs)
        seen = took / (cost * (step - first) / (progress - before))
        seen = min(max(seen, self._unit / _JUMP), self._unit * _JUMP)
        self._unit += _TRUST * (seen - self._unit)
        per_step = stride(progress, self._seconds - now, self._unit, self._legs)
        self._anchor = (step, progress, per_step)
        self._window = self._clock()
        self.steps = step + max(1, math.ceil((1.0 - progress) / per_step - 1e-9))

    def validates(self, step: int) -> bool:
        """Whether a validation follows this step."""
        if self._seconds is None:
            return step % self._every[0] == 0 or self.done(step)
        return self._due or self.done(step)

    def saves(self, step: int) -> bool:
        """Whether a save follows this step."""
        if self._seconds is None:
            return step % self._every[1] == 0 or self.done(step)
        return self._due or self.done(step)

    def seconds_left(self, step: int) -> float | None:
        """Of the promise, or at the rate of this process; None where nothing is known."""
        if self._seconds is not None:
            return max(0.0, self._seconds - self.elapsed)
        done = step - self._first
        return (self._clock() - self._began) * (self.steps - step) / done if done else None

    def state(self) -> dict[str, Any]:
        """What `restore` needs to keep the promise in another process."""
        step, progress, per_step = self._anchor
        numbers = {"step": step, "progress": progress, "per_step": per_step, "unit": self._unit}
        return {**numbers, "spent": self.elapsed, "steps": self.steps, "save_at": self._save_at}

    def restore(self, state: Mapping[str, Any], step: int) -> None:
        """Go on where another process stopped after a step; its seconds count."""
        self._first = step
        self._began = self._window = self._clock()
        if self._seconds is None or not state:
            return
        self.spent, self.steps = state["spent"], state["steps"]
        self._unit, self._save_at = state["unit"], state["save_at"]
        self._anchor = (state["step"], state["progress"], state["per_step"])
        # The window begins anew: the time between the processes belongs to none.
        self._anchor = (step, self.progress(step), state["per_step"])
