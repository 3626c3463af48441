"""The loop that both stages share: rates, steps, validation, saving, interruption."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

import torch

from pcore.data.scene import View
from pcore.errors import TrainingError
from pcore.files.provenance import provenance_of
from pcore.files.run_folder import RunFolder
from pcore.training.compiling import compiler_errors_explained
from pcore.training.config import Background
from pcore.training.events import Listener, Saved, StepReport, Stopped, ValidationReport
from pcore.training.held_out import validate
from pcore.training.losses import Losses
from pcore.training.schedule import Schedule
from pcore.training.trainable import Trainable, restore
from pcore.training.trained import Trained

_REPORT_EVERY = 10


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a loop does besides its steps.

    Attributes:
        steps: optimiser steps in all.
        rates: learning rates by the names of the optimiser's groups.
        validate_every: steps between validations.
        save_every: steps between saves.
        validation: held-out training views.
        background: behind images with alpha.
        scene: name of the scene, for the model file.
    """

    steps: int
    rates: Mapping[str, Schedule]
    validate_every: int
    save_every: int
    validation: Sequence[View]
    background: Background
    scene: str


def run_loop(
    work: Trainable,
    plan: Plan,
    losses: Callable[[], Losses],
    *,
    after_step: Callable[[Listener], None] = lambda listener: None,
    accept: Callable[[float], bool] = lambda psnr: True,
    folder: RunFolder | None = None,
    listener: Listener,
) -> Trained:
    """Train to the last step; the result is the last weights that `accept` did not refuse.

    Args:
        work: what is trained; continued from the folder's state when it holds one.
        plan: steps, rates, validation, saving.
        losses: draws a batch and computes the terms of the coming step, with gradients.
        after_step: changes the population.
        accept: whether weights with this validation PSNR may become the result, where
            `work.best` keeps weights.
        folder: where to save; None keeps everything in memory.
        listener: told everything.

    Raises:
        TrainingError: the loss is not finite, networks cannot be compiled, or the folder cannot be
            written.
        KeyboardInterrupt: after Ctrl-C, with everything saved.
    """
    _resume(work, folder)
    if work.step >= plan.steps:
        # Killed between the files of the last save: complete them.
        _save(work, plan, folder, listener, finished=True)
    clock = _Clock(work.step, plan.steps)
    with _deferred_interrupt() as interrupted:
        while work.step < plan.steps:
            found = _step(work, plan, losses)
            after_step(listener)
            if work.step % _REPORT_EVERY == 0 or work.step == plan.steps:
                listener(_report(work, plan, found, clock))
            if work.step % plan.validate_every == 0 or work.step == plan.steps:
                _validate(work, plan, accept, listener)
            last = work.step == plan.steps or bool(interrupted)
            if last or work.step % plan.save_every == 0:
                _save(work, plan, folder, listener, finished=last and not interrupted)
            if interrupted:
                _stop(work, folder, listener)
    listener(_finished(work))
    return _result(work)


def _finished(work: Trainable) -> Stopped:
    """Say which weights the result has, where they are not the last ones."""
    kept, message = work.best.get("kept_step", work.step), ""
    if kept != work.step:
        whose = f"of step {kept}" if kept else "that it began with, so nothing was learned"
        message = (
            f"the result has the weights {whose}: later ones fell too far behind on held-out "
            "training views; lower the weights of the losses or the learning rates"
        )
    return Stopped(stage=work.stage, step=work.step, reason="finished", message=message)


def _step(work: Trainable, plan: Plan, losses: Callable[[], Losses]) -> Losses:
    work.set_rates(plan.rates, plan.steps)
    work.optimizer.zero_grad(set_to_none=True)
    with compiler_errors_explained():
        found = losses()
        found.total.backward()
    work.optimizer.step()
    work.step += 1
    return found


def _report(work: Trainable, plan: Plan, found: Losses, clock: _Clock) -> StepReport:
    figures = [found.total, found.squared_error, *found.terms.values()]
    # All at once: every transfer from a GPU waits for it.
    loss, error, *terms = torch.stack(figures).detach().tolist()
    if not math.isfinite(loss):
        raise TrainingError(
            f"{work.stage}: the loss is {loss} at step {work.step}; what was saved before is "
            "untouched. Lower the learning rates, or check the images and poses"
        )
    return StepReport(
        stage=work.stage,
        step=work.step,
        steps=plan.steps,
        loss=loss,
        losses=dict(zip(found.terms, terms, strict=True)),
        psnr=-10 * math.log10(max(error, 1e-12)),
        points=len(work.cloud),
        seconds_left=clock.seconds_left(work.step),
        rates={group["name"]: group["lr"] for group in work.optimizer.param_groups},
    )


def _validate(
    work: Trainable, plan: Plan, accept: Callable[[float], bool], listener: Listener
) -> None:
    if not plan.validation:
        return
    scores = validate(work.result(), plan.validation, plan.background)
    psnr = scores["psnr"]
    best = psnr > work.best.get("psnr", -math.inf)
    if best:
        work.best = {**work.best, "psnr": psnr, "step": work.step}
    accepted = accept(psnr)
    if "weights" in work.best and accepted:
        work.best["weights"] = {k: t.clone() for k, t in work.weights().items()}
        work.best |= {"kept_step": work.step, "kept_psnr": psnr}
    listener(
        ValidationReport(
            stage=work.stage,
            step=work.step,
            psnr=psnr,
            views=len(plan.validation),
            scores=scores,
            best=best,
            accepted=accepted,
        )
    )


def _result(work: Trainable) -> Trained:
    """Return the last weights that validation accepted, where those are kept, else the last."""
    return work.result(work.best.get("weights"))


def _resume(work: Trainable, folder: RunFolder | None) -> None:
    state = folder.load_state() if folder is not None else None
    if state is not None:
        restore(work, state)


def _save(
    work: Trainable, plan: Plan, folder: RunFolder | None, listener: Listener, *, finished: bool
) -> None:
    _check_finite(work)
    if folder is None:
        return
    folder.save_state(work.state())
    listener(Saved(stage=work.stage, step=work.step, path=str(folder.state)))
    result = _result(work)
    config = result.papr.config
    folder.save_model(
        result.papr.state_dict(),
        result.cloud,
        config,
        provenance_of(
            result.cloud,
            config,
            scene=plan.scene,
            stage="pretrain" if work.stage == "pretrain" else "finetune",
            step=work.best.get("kept_step", work.step),
        ),
    )
    listener(Saved(stage=work.stage, step=work.step, path=str(folder.model)))
    if result.skinning is not None:
        folder.save_skinning(result.skinning)
        listener(Saved(stage=work.stage, step=work.step, path=str(folder.skinning)))
    best = {key: value for key, value in work.best.items() if isinstance(value, int | float)}
    status = "finished" if finished else "running"
    folder.update(status=status, step=work.step, validation=best)


def _check_finite(work: Trainable) -> None:
    """Raise TrainingError before weights that are not finite replace good ones on the disk."""
    bad = [name for name, t in work.weights().items() if not bool(torch.isfinite(t).all())]
    if bad:
        raise TrainingError(
            f"{work.stage}: weights are not finite at step {work.step} ({', '.join(bad[:3])}); "
            "what was saved before is untouched. Lower the learning rates, or check the poses"
        )


def _stop(work: Trainable, folder: RunFolder | None, listener: Listener) -> None:
    listener(Stopped(stage=work.stage, step=work.step, reason="interrupted"))
    if folder is not None:
        folder.update(status="stopped")
    if folder is None:
        raise KeyboardInterrupt(f"{work.stage} stopped at step {work.step}; nothing was saved")
    raise KeyboardInterrupt(
        f"step {work.step} is saved in {folder.path}; the same command goes on from there "
        "(`pcore train` and `pcore finetune` with --resume)"
    )


class _Clock:
    """Estimates the time that is left from the steps of this process."""

    def __init__(self, first: int, steps: int) -> None:
        self._first, self._steps, self._start = first, steps, time.monotonic()

    def seconds_left(self, step: int) -> float | None:
        done = step - self._first
        return (time.monotonic() - self._start) * (self._steps - step) / done if done else None


@contextmanager
def _deferred_interrupt() -> Generator[list[int]]:
    """Collect Ctrl-C until the step is complete; a second one interrupts at once."""
    seen: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield seen  # Signals only reach the main thread.
        return
    before = signal.getsignal(signal.SIGINT)

    def handle(number: int, frame: FrameType | None) -> None:
        if seen:
            raise KeyboardInterrupt
        seen.append(number)

    signal.signal(signal.SIGINT, handle)
    try:
        yield seen
    finally:
        signal.signal(signal.SIGINT, before)


def autocast(device: torch.device, *, enabled: bool) -> torch.autocast:
    """Half precision on a GPU (bfloat16 needs no loss scaling); never on the CPU."""
    return torch.autocast(
        device.type, dtype=torch.bfloat16, enabled=enabled and device.type != "cpu"
    )
