"""Pace: schedules by steps, promises kept on clocks that are made up."""

from __future__ import annotations

import pytest

from pcore.errors import InputError
from pcore.training.pace import Leg, Pace, stride, work_left

LEGS = (Leg(end=0.4, cost=1.0), Leg(end=1.0, cost=5.0))


class Machine:
    """A clock, and steps that take what a made-up machine takes for them."""

    def __init__(self, unit: float) -> None:
        self.now, self.unit = 100.0, unit

    def __call__(self) -> float:
        return self.now

    def run(self, pace: Pace, step: int = 0, until: int | None = None) -> int:
        """Make steps to the end, or to a step."""
        while not pace.done(step) and step != until:
            cost = LEGS[0].cost if pace.progress(step) < LEGS[0].end else LEGS[1].cost
            self.now += self.unit * cost
            step += 1
            pace.after(step)
        return step


def promise(machine: Machine, seconds: float = 600.0, steps: int = 1000) -> Pace:
    return Pace(steps, seconds=seconds, legs=LEGS, clock=machine)


def test_without_a_promise_progress_is_the_share_of_the_steps() -> None:
    pace = Pace(40, validate_every=20, save_every=15)
    assert [pace.progress(step) for step in (0, 10, 40)] == [0.0, 0.25, 1.0]
    assert (pace.length(7), pace.steps) == (40, 40)
    assert [step for step in range(1, 41) if pace.validates(step)] == [20, 40]
    assert [step for step in range(1, 41) if pace.saves(step)] == [15, 30, 40]
    assert pace.done(40)
    assert not pace.done(39)


def test_work_is_what_the_legs_cost() -> None:
    assert work_left(0.0, LEGS) == pytest.approx(0.4 + 5 * 0.6)
    assert work_left(0.7, LEGS) == pytest.approx(5 * 0.3)
    # 3.4 units of work in 340 seconds at a second each: a hundredth of the schedule per step.
    assert stride(0.0, 340.0, 1.0, LEGS) == pytest.approx(0.01)
    assert stride(0.9, -1.0, 1.0, LEGS) == pytest.approx(0.1)


@pytest.mark.parametrize("slower", [0.3, 1.0, 2.5])
def test_a_promise_is_kept_on_machines_that_were_measured_wrongly(slower: float) -> None:
    machine = Machine(slower * 600 / 3400)
    pace = promise(machine)
    steps = machine.run(pace)
    assert pace.elapsed == pytest.approx(600, rel=0.03)
    assert steps == pytest.approx(1000 / slower, rel=0.25)
    assert pace.progress(steps) == pytest.approx(1.0, abs=0.01)


def test_a_machine_that_becomes_busy_half_way_keeps_its_promise() -> None:
    machine = Machine(600 / 3400)
    pace = promise(machine)
    step = machine.run(pace, until=500)
    machine.unit *= 3
    machine.run(pace, step)
    assert pace.elapsed == pytest.approx(600, rel=0.05)


def test_a_run_that_goes_on_counts_the_seconds_of_the_first_process() -> None:
    machine = Machine(600 / 3400)
    first = promise(machine)
    step = machine.run(first, until=400)
    before, state = first.elapsed, first.state()
    machine.now += 1e5  # A night between the two.
    second = promise(machine)
    second.restore(state, step)
    assert second.progress(step) == pytest.approx(first.progress(step))
    machine.run(second, step)
    assert second.elapsed == pytest.approx(600, rel=0.03)
    assert before < 600


def test_an_object_stands_early_and_is_saved_now_and_then() -> None:
    machine = Machine(1200 / 3400)
    pace = promise(machine, seconds=1200)
    saves: list[float] = []
    step = 0
    while not pace.done(step):
        step = machine.run(pace, step, step + 1)
        if pace.saves(step):
            assert pace.validates(step)
            saves.append(pace.elapsed)
    assert 90 <= saves[0] < 95
    assert len(saves) == pytest.approx(7, abs=1)


def test_schedules_count_in_the_steps_that_the_progress_stands_for() -> None:
    machine = Machine(2 * 600 / 3400)
    pace = promise(machine)
    step = machine.run(pace, until=200)
    assert step / pace.length(step) == pytest.approx(pace.progress(step))


def test_no_time_is_refused() -> None:
    with pytest.raises(InputError, match="time above 0"):
        Pace(10, seconds=0.0)
