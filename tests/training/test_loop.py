"""The loop of both stages: rates, reports, validation, saving, interruption, resuming."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from pcore.errors import CheckpointError, TrainingError
from pcore.files.model_file import load_model
from pcore.files.run_folder import RunFolder
from pcore.training import trainable
from pcore.training.budget import Budget
from pcore.training.config import Rates
from pcore.training.events import Saved, StepReport, Stopped, ValidationReport
from pcore.training.loop import run_loop
from pcore.training.loop_plan import Plan
from pcore.training.losses import Losses
from pcore.training.schedule import Schedule
from pcore.training.trainable import Trainable
from pcore.training.trained import Trained
from small_training import RATES, Heard, assert_same, box_work, copied, weights_of


def plan(**changes: Any) -> Plan:
    settings: dict[str, Any] = {
        "steps": 6,
        "rates": RATES.named(),
        "validate_every": 2,
        "save_every": 3,
        "validation": (),
        "background": "white",
        "scene": "box",
    }
    return Plan(**{**settings, **changes})


def pull(work: Trainable, at: Callable[[int], None] = lambda step: None) -> Callable[[], Losses]:
    """A loss that draws a random target and pulls every weight towards it."""

    def losses() -> Losses:
        at(work.step)
        target = torch.rand((), generator=work.generator)
        tensors = [*work.papr.parameters(), work.cloud.positions, work.cloud.features]
        total = torch.stack([(t - target).square().mean() for t in tensors]).sum()
        total = total + (work.cloud.influence - target).square().mean()
        return Losses(terms={"pull": total}, squared_error=total.detach() / 100)

    return losses


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[RunFolder]:
    with open_folder(tmp_path / "run") as run:
        yield run


def open_folder(path: Path, **options: Any) -> RunFolder:
    return RunFolder.create(path, stage="pretrain", scene="box", config={}, **options)


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch) -> Callable[[Sequence[float]], list[Trained]]:
    """Let validations find these PSNRs one after another; returns what was validated."""

    def script(psnrs: Sequence[float]) -> list[Trained]:
        rest, seen = list(psnrs), list[Trained]()

        def validate(model: Trained, *others: object, **more: object) -> dict[str, float]:
            seen.append(model)
            return {"psnr": rest.pop(0)}

        monkeypatch.setattr(trainable, "validate", validate)
        return seen

    return script


# --- steps ------------------------------------------------------------------------------------


def test_rates_follow_their_schedules() -> None:
    work, heard = box_work(), Heard()
    rates = Rates(
        points=Schedule(base=2e-3, warmup=4),
        attention=Schedule(base=1e-3),
        features=Schedule(base=2e-2, final=0.5),
        influence=Schedule(base=3e-2),
        unet=Schedule(base=4e-3),
    )
    run_loop(work, plan(steps=10, rates=rates.named()), pull(work), listener=heard)
    (report,) = heard.of(StepReport)
    expected = {name: schedule.at(9, 10) for name, schedule in rates.named().items()}
    # Positions are in world units, their rate in scaled units.
    expected["points"] /= work.papr.config.coord_scale
    assert report.rates == pytest.approx(expected)


def test_every_group_holds_its_own_parameters() -> None:
    """With one rate of zero, exactly those weights stay."""
    for name in ("points", "attention", "features", "influence", "unet"):
        work = box_work()
        before = copied(work.weights())
        rates = {**RATES.named(), name: Schedule(base=0.0)}
        run_loop(work, plan(steps=2, rates=rates), pull(work), listener=Heard())
        after = work.weights()
        group = {
            "points": "cloud.positions",
            "features": "cloud.features",
            "influence": "cloud.influence",
            "attention": "papr.attention.",
            "unet": "papr.unet.",
        }
        for key in before:
            # A target of no parameter is exactly where it started: all others move.
            assert torch.equal(before[key], after[key]) == key.startswith(group[name]), (name, key)


# --- events -----------------------------------------------------------------------------------


def test_events_come_in_order(
    folder: RunFolder, scripted: Callable[[Sequence[float]], list[Trained]]
) -> None:
    scripted([20.0, 22.0, 21.0])
    work, heard = box_work(), Heard()
    run_loop(
        work,
        plan(steps=24, validate_every=10, save_every=20, validation=("a view",)),
        pull(work),
        folder=folder,
        listener=heard,
    )
    assert [(type(event), event.step) for event in heard] == [
        (StepReport, 10),
        (ValidationReport, 10),
        (StepReport, 20),
        (ValidationReport, 20),
        (Saved, 20),
        (Saved, 20),
        (StepReport, 24),
        (ValidationReport, 24),
        (Saved, 24),
        (Saved, 24),
        (Stopped, 24),
    ]
    assert [event.best for event in heard.of(ValidationReport)] == [True, True, False]
    assert [Path(event.path).name for event in heard.of(Saved)[:2]] == [
        "state.pt",
        "model.safetensors",
    ]
    assert heard.of(Stopped)[0].reason == "finished"
    assert folder.notes["status"] == "finished"
    assert folder.notes["validation"] == {"psnr": 22.0, "step": 20}
    report = heard.of(StepReport)[-1]
    assert (report.steps, report.points) == (24, 60)
    assert report.losses == {"pull": pytest.approx(report.loss)}
    assert report.psnr == pytest.approx(-10 * torch.tensor(report.loss / 100).log10().item())
    assert report.seconds_left == 0


@pytest.mark.parametrize(("every", "expected"), [(2, [2, 4, 5]), (5, [5]), (9, [5])])
def test_validation_every_so_many_steps_and_at_the_end(
    every: int, expected: list[int], scripted: Callable[[Sequence[float]], list[Trained]]
) -> None:
    seen = scripted([20.0] * 3)
    work, heard = box_work(), Heard()
    changed = plan(steps=5, validate_every=every, validation=("a view",))
    run_loop(work, changed, pull(work), listener=heard)
    assert [event.step for event in heard.of(ValidationReport)] == expected
    assert [model.step for model in seen] == expected


def test_validations_end_where_their_views_are_learned_from(
    folder: RunFolder, scripted: Callable[[Sequence[float]], list[Trained]]
) -> None:
    """Once more right there, whatever their distance; a run that goes on after it has none."""
    scripted([20.0] * 9)
    work, heard = box_work(), Heard()
    changed = plan(
        steps=9, validate_every=3, save_every=6, validation=("a view",), validate_until=0.5
    )
    run_loop(work, changed, pull(work), folder=folder, listener=heard)
    found = heard.of(ValidationReport)
    assert [(event.step, event.learned_next) for event in found] == [(3, False), (5, True)]
    state = folder.load_state()
    assert state is not None
    folder.save_state(replace(state, step=6))
    again, heard = box_work(), Heard()
    run_loop(again, changed, pull(again), folder=folder, listener=heard)
    assert again.step == 9
    assert heard.of(ValidationReport) == []


def test_without_held_out_views_nothing_is_validated() -> None:
    work, heard = box_work(), Heard()
    run_loop(work, plan(), pull(work), listener=heard)
    assert heard.of(ValidationReport) == []


# --- what a budget refuses does not become the result -------------------------------------------


def test_the_result_is_the_part_of_the_way_that_meets_the_budget(
    folder: RunFolder, scripted: Callable[[Sequence[float]], list[Trained]]
) -> None:
    seen = scripted([29.5, 29.9, 28.0, 28.5, 29.2, *[28.9] * 5])
    work, heard = box_work(), Heard()
    before = copied(work.weights())
    result = run_loop(
        work,
        plan(steps=6, validation=("a view",)),
        pull(work),
        budget=Budget(before=before, psnr=[30.0], largest_loss=1.0),
        folder=folder,
        listener=heard,
    )
    assert (work.step, heard[-1].reason) == (6, "finished")  # pyright: ignore
    # Three validations, then the half (refused), the quarter (met), and nothing beyond it.
    assert len(seen) == 10
    assert_same(weights_of(result), weights_of(seen[4]))
    expected = before["cloud.features"].lerp(seen[2].cloud.features, 0.25)
    assert torch.equal(result.cloud.features, expected)
    saved = load_model(folder.path)
    assert torch.equal(saved.cloud.features, result.cloud.features)
    assert folder.notes["status"] == "finished"
    assert folder.notes["validation"]["psnr"] == 29.9
    assert folder.notes["trade"]["share"] == 0.25


# --- what goes wrong --------------------------------------------------------------------------


def spoiled(work: Trainable, step: int) -> Callable[[], Losses]:
    """A loss that is not a number at one step (counted from 0) and after it."""
    inner = pull(work)

    def losses() -> Losses:
        found = inner()
        if work.step < step:
            return found
        return Losses(terms={"pull": found.total * torch.nan}, squared_error=found.squared_error)

    return losses


def ruined(work: Trainable, step: int) -> Callable[[], Losses]:
    """A loss that stays finite while its gradient is not a number at one step."""
    inner = pull(work)

    def losses() -> Losses:
        found = inner()
        if work.step != step:
            return found
        # The root has no slope at zero: 0 times infinity.
        steep = (0 * work.cloud.positions).sum().sqrt()
        return Losses(terms={**found.terms, "steep": steep}, squared_error=found.squared_error)

    return losses


def test_a_loss_that_is_not_finite_is_an_error(folder: RunFolder) -> None:
    work, heard = box_work(), Heard()
    with pytest.raises(TrainingError, match=r"pretrain: the loss is nan at step 10.*Lower the"):
        run_loop(work, plan(steps=20), spoiled(work, 9), folder=folder, listener=heard)
    state = folder.load_state()
    assert state is not None
    assert state.step == 9
    assert bool(state.cloud["positions"].isfinite().all())
    assert heard.of(Stopped) == []


@pytest.mark.parametrize("ruin", [spoiled, ruined])
def test_weights_that_are_not_finite_are_never_saved(
    ruin: Callable[[Trainable, int], Callable[[], Losses]], folder: RunFolder
) -> None:
    """Also between two reports, and when the loss itself is still a number."""
    work = box_work()
    with pytest.raises(TrainingError):
        run_loop(work, plan(steps=20), ruin(work, 4), folder=folder, listener=Heard())
    state = folder.load_state()
    assert state is not None
    assert state.step == 3
    assert bool(state.cloud["positions"].isfinite().all())


def test_a_state_of_another_stage_is_refused(folder: RunFolder) -> None:
    folder.save_state(box_work("finetune").state())
    work = box_work()
    with pytest.raises(CheckpointError, match="expected one of stage 'pretrain', got 'finetune'"):
        run_loop(work, plan(), pull(work), folder=folder, listener=Heard())


# --- interruption -----------------------------------------------------------------------------


def ctrl_c(step: int) -> Callable[[int], None]:
    def at(now: int) -> None:
        if now == step:
            signal.raise_signal(signal.SIGINT)

    return at


def test_ctrl_c_finishes_the_step_saves_and_says_how_to_go_on(tmp_path: Path) -> None:
    whole = box_work()
    expected = run_loop(whole, plan(), pull(whole), listener=Heard())

    path, handler = tmp_path / "run", signal.getsignal(signal.SIGINT)
    work, heard = box_work(), Heard()
    with (
        open_folder(path) as run,
        pytest.raises(
            KeyboardInterrupt,
            match=r"step 2 is saved in .*run; the same command goes on .* with --resume",
        ),
    ):
        run_loop(work, plan(), pull(work, ctrl_c(1)), folder=run, listener=heard)
    assert signal.getsignal(signal.SIGINT) is handler
    assert heard[-1] == Stopped(stage="pretrain", step=2, reason="interrupted")
    assert RunFolder.open(path).notes["status"] == "stopped"

    work = box_work()
    with open_folder(path, resume=True) as run:
        result = run_loop(work, plan(), pull(work), folder=run, listener=Heard())
    assert_same(weights_of(result), weights_of(expected))
    assert RunFolder.open(path).notes["status"] == "finished"


def test_ctrl_c_without_a_folder_says_that_nothing_is_saved() -> None:
    work = box_work()
    with pytest.raises(KeyboardInterrupt, match="stopped at step 4; nothing was saved"):
        run_loop(work, plan(), pull(work, ctrl_c(3)), listener=Heard())


def test_a_second_ctrl_c_stops_at_once(folder: RunFolder) -> None:
    def at(step: int) -> None:
        signal.raise_signal(signal.SIGINT)

    work, heard = box_work(), Heard()
    losses = pull(work, at)

    def impatient() -> Losses:
        losses()
        return losses()

    with pytest.raises(KeyboardInterrupt):
        run_loop(work, plan(), impatient, folder=folder, listener=heard)
    assert work.step == 0
    assert heard == []


class Killed(BaseException):
    """Stands for SIGKILL: nobody catches it."""


@pytest.mark.parametrize(
    ("save", "doomed"),
    [
        (1, "save_state"),
        (1, "save_model"),
        (1, "update"),
        (2, "save_state"),
        (2, "save_model"),
        (2, "update"),
    ],
)
def test_killed_between_the_files_of_a_save(
    doomed: str, save: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed before the state, the model or the notes of the first or the last save."""
    whole = box_work()
    expected = run_loop(whole, plan(), pull(whole), listener=Heard())

    path, work = tmp_path / "run", box_work()
    with open_folder(path) as run:
        original, calls = getattr(RunFolder, doomed), [0]

        def die(self: RunFolder, *args: Any, **options: Any) -> None:
            calls[0] += 1
            if calls[0] == save:
                raise Killed
            original(self, *args, **options)

        with monkeypatch.context() as patch:
            patch.setattr(RunFolder, doomed, die)
            with pytest.raises(Killed):
                run_loop(work, plan(), pull(work), folder=run, listener=Heard())

    work = box_work()
    with open_folder(path, resume=True) as run:
        result = run_loop(work, plan(), pull(work), folder=run, listener=Heard())
    assert_same(weights_of(result), weights_of(expected))
    saved = load_model(path)
    assert torch.equal(saved.cloud.features, expected.cloud.features)
    assert saved.provenance.step == 6
    assert RunFolder.open(path).notes["status"] == "finished"


def test_a_state_that_counts_from_elsewhere_is_refused(tmp_path: Path) -> None:
    path, away = tmp_path / "run", torch.tensor([2000.0, 0.0, 0.0], dtype=torch.float64)
    work = box_work()
    work.origin = away
    with open_folder(path) as run:
        moved = run_loop(work, plan(), pull(work), folder=run, listener=Heard())
    near = work.cloud.positions.detach().double() + away
    assert torch.equal(moved.cloud.positions, near.float())
    assert torch.equal(load_model(path).cloud.positions, near.float())

    again = box_work()
    again.origin = away
    with open_folder(path, resume=True) as run:
        result = run_loop(again, plan(), pull(again), folder=run, listener=Heard())
        assert torch.equal(result.cloud.positions, moved.cloud.positions)
        with pytest.raises(CheckpointError, match=r"count from the origin, got them from \[2000"):
            run_loop(work := box_work(), plan(), pull(work), folder=run, listener=Heard())
