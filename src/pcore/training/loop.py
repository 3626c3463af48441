"""The loop that both stages share: rates, steps, validation, saving, interruption."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from statistics import fmean
from typing import Any, TypeVar

import torch
from torch import Tensor

from pcore.errors import CheckpointError, TrainingError
from pcore.files.run_folder import RunFolder
from pcore.files.training_state import TrainingState
from pcore.training.budget import Budget, largest_part
from pcore.training.compiling import compiler_errors_explained
from pcore.training.events import (
    BudgetReport,
    Listener,
    Saved,
    StepReport,
    Stopped,
    ValidationReport,
)
from pcore.training.held_out import mean_of_views, scores_by_view
from pcore.training.interrupt import deferred_interrupt
from pcore.training.loop_plan import Plan
from pcore.training.losses import Losses
from pcore.training.pace import Pace
from pcore.training.ranks import Ranks, current_ranks
from pcore.training.work import Work

Result = TypeVar("Result")

_REPORT_EVERY = 10


def run_loop(
    work: Work[Result],
    plan: Plan,
    losses: Callable[[], Losses],
    *,
    after_step: Callable[[Listener], None] = lambda listener: None,
    finish: Callable[[Listener], None] = lambda listener: None,
    budget: Budget | None = None,
    folder: RunFolder | None = None,
    listener: Listener,
) -> Result:
    """Train to the last step; the result meets the budget, where there is one.

    Args:
        work: what is trained; continued from the folder's state when it holds one.
        plan: steps, rates, validation, saving.
        losses: draws a batch and computes the terms of the coming step, with gradients.
        after_step: changes the population.
        finish: adds to the work, when all steps are done, what its result has besides weights.
        budget: what the result may cost; None takes the last weights. Where the last ones cost
            more, it is as much of the way to them as the budget allows. A run that is stopped has
            the weights of the last validation that met it, else those before.
        folder: where to save; None keeps everything in memory. Of several processes that train
            together, only the first has one.
        listener: told everything.

    Raises:
        TrainingError: the loss is not finite, networks cannot be compiled, or the folder cannot be
            written.
        CheckpointError: the folder's state is of another stage, architecture or origin.
        KeyboardInterrupt: after Ctrl-C, with everything saved.
    """
    if budget is not None:
        work.best = {"weights": {k: t.clone() for k, t in budget.before.items()}, "kept_step": 0}
    ranks = current_ranks()
    pace = plan.pace or Pace.of(plan)
    state = folder.load_state() if folder is not None else None
    _resume(work, plan, pace, ranks.from_first(state))
    if pace.done(work.step):
        # Killed between the files of the last save: complete them.
        finish(listener)
        _save(work, plan, pace, folder, listener, finished=True)
    with deferred_interrupt() as interrupted:
        while not pace.done(work.step):
            unseen = pace.progress(work.step) < plan.validate_until
            found = _step(work, plan, pace, losses, ranks)
            after_step(listener)
            pace.after(work.step)
            last_unseen = unseen and pace.progress(work.step) >= plan.validate_until
            if work.step % _REPORT_EVERY == 0 or pace.done(work.step):
                listener(_report(work, pace, found))
            if last_unseen or (unseen and pace.validates(work.step)):
                _validate(work, plan, pace, budget, listener, last=last_unseen)
            stop = ranks.any(bool(interrupted))
            finished = pace.done(work.step) and not stop
            if finished:
                finish(listener)
            if finished or stop or pace.saves(work.step):
                ranks.check_same(work.weights(), work.step)
                _save(work, plan, pace, folder, listener, finished=finished)
            if stop:
                _stop(work, folder, listener)
    listener(_finished(work))
    # Those that met the budget last, where they are kept, else the last ones.
    return work.result(work.best.get("weights"))


def _finished(work: Work[Any]) -> Stopped:
    """Say how it went on, and whether nothing of it could be kept."""
    message = ""
    if work.best.get("trade", {}).get("share") == 0:
        message = (
            "the result renders as before: no part of the change keeps held-out training views "
            "within the budget; lower the weights of the losses or the learning rates"
        )
    return Stopped(stage=work.stage, step=work.step, reason="finished", message=message)


def _step(
    work: Work[Any], plan: Plan, pace: Pace, losses: Callable[[], Losses], ranks: Ranks
) -> Losses:
    work.set_rates(plan.rates, pace.length(work.step))
    work.optimizer.zero_grad(set_to_none=True)
    with compiler_errors_explained():
        found = losses()
        found.total.backward()
    learned = [p for group in work.optimizer.param_groups for p in group["params"]]
    ranks.add_gradients(learned if plan.exposure is None else [*learned, plan.exposure.change])
    work.optimizer.step()
    if plan.exposure is not None:
        plan.exposure.step(pace.progress(work.step))
    work.step += 1
    with torch.no_grad():
        ranks.add([found.squared_error, *found.terms.values()])
    return found


def _report(work: Work[Any], pace: Pace, found: Losses) -> StepReport:
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
        steps=pace.steps,
        loss=loss,
        losses=dict(zip(found.terms, terms, strict=True)),
        psnr=-10 * math.log10(max(error, 1e-12)),
        points=work.points,
        seconds_left=pace.seconds_left(work.step),
        rates={group["name"]: group["lr"] for group in work.optimizer.param_groups},
    )


def _validate(
    work: Work[Any],
    plan: Plan,
    pace: Pace,
    budget: Budget | None,
    listener: Listener,
    *,
    last: bool,
) -> None:
    if not plan.validation:
        return
    found = scores_by_view(work, plan.validation, plan.background)
    scores = mean_of_views(found)
    psnr = scores["psnr"]
    best = psnr > work.best.get("psnr", -math.inf)
    if best:
        work.best = {**work.best, "psnr": psnr, "step": work.step}
    listener(
        ValidationReport(
            stage=work.stage,
            step=work.step,
            psnr=psnr,
            views=len(plan.validation),
            scores=scores,
            best=best,
            learned_next=last and not pace.done(work.step),
            accepted=budget is None or budget.met_by([one["psnr"] for one in found]),
        )
    )
    if budget is not None:
        _keep(work, plan, budget, [one["psnr"] for one in found], listener, last=last)


def _keep(
    work: Work[Any],
    plan: Plan,
    budget: Budget,
    psnr: Sequence[float],
    listener: Listener,
    *,
    last: bool,
) -> None:
    """Keep weights that meet the budget: these or, at the end, a part of the way to them."""
    if not (last or budget.met_by(psnr)):
        return

    def score(weights: Mapping[str, Tensor]) -> list[float]:
        found = scores_by_view(work, plan.validation, plan.background, weights)
        return [one["psnr"] for one in found]

    part = largest_part(budget, work.weights(), psnr, score)
    work.best["weights"] = {name: t.clone() for name, t in part.weights.items()}
    work.best |= {"kept_step": work.step, "kept_psnr": fmean(part.psnr)}
    if last:
        ends = {"before": fmean(budget.psnr), "after": fmean(psnr), "psnr": fmean(part.psnr)}
        trade = {"share": part.share, **ends}
        work.best["trade"] = {**trade, "largest_loss": budget.largest_loss}
        listener(BudgetReport(stage=work.stage, step=work.step, **work.best["trade"]))


def _resume(work: Work[Any], plan: Plan, pace: Pace, state: TrainingState | None) -> None:
    if state is not None:
        _check_origin(work, state)
        work.restore(state)
        pace.restore(state.optimisers.get("pace", {}), work.step)
        if plan.exposure is not None:
            plan.exposure.restore(state.optimisers.get("exposure", {}))


def _check_origin(work: Work[Any], state: TrainingState) -> None:
    """Raise CheckpointError where a state counts places from elsewhere (`near_origin`)."""
    known, own = state.optimisers.get("origin", {}).get("at"), _origin(work)
    if known != own:
        raise CheckpointError(
            f"training state: expected places that count from {own or 'the origin'}, got them from "
            f"{known or 'the origin'}; it is of other poses or of an older version: train anew"
        )


def _origin(work: Work[Any]) -> list[float] | None:
    return None if work.origin is None else work.origin.tolist()


def _save(
    work: Work[Any],
    plan: Plan,
    pace: Pace,
    folder: RunFolder | None,
    listener: Listener,
    *,
    finished: bool,
) -> None:
    _check_finite(work)
    if folder is None:
        return
    state = work.state()
    more: dict[str, Any] = {"pace": pace.state(), "origin": {"at": _origin(work)}}
    if plan.exposure is not None:
        more["exposure"] = plan.exposure.state()
    folder.save_state(replace(state, optimisers={**state.optimisers, **more}))
    listener(Saved(stage=work.stage, step=work.step, path=str(folder.state)))
    for path in work.save(folder, plan.scene):
        listener(Saved(stage=work.stage, step=work.step, path=path))
    best = {key: value for key, value in work.best.items() if isinstance(value, int | float)}
    trade = {"trade": work.best["trade"]} if "trade" in work.best else {}
    status = "finished" if finished else "running"
    folder.update(status=status, step=work.step, validation=best, **trade)


def _check_finite(work: Work[Any]) -> None:
    """Raise TrainingError before weights that are not finite replace good ones on the disk."""
    bad = [name for name, t in work.weights().items() if not bool(torch.isfinite(t).all())]
    if bad:
        raise TrainingError(
            f"{work.stage}: weights are not finite at step {work.step} ({', '.join(bad[:3])}); "
            "what was saved before is untouched. Lower the learning rates, or check the poses"
        )


def _stop(work: Work[Any], folder: RunFolder | None, listener: Listener) -> None:
    listener(Stopped(stage=work.stage, step=work.step, reason="interrupted"))
    if folder is not None:
        folder.update(status="stopped")
    if folder is None:
        raise KeyboardInterrupt(f"{work.stage} stopped at step {work.step}; nothing was saved")
    raise KeyboardInterrupt(
        f"step {work.step} is saved in {folder.path}; the same command goes on from there "
        "(`pcore train` and `pcore finetune` with --resume)"
    )


def autocast(device: torch.device, *, enabled: bool) -> torch.autocast:
    """Half precision on a GPU (bfloat16 needs no loss scaling); never on the CPU."""
    return torch.autocast(
        device.type, dtype=torch.bfloat16, enabled=enabled and device.type != "cpu"
    )
