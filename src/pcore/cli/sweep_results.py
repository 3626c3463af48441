"""`pcore sweep`: what is left to run, where, and its results in the terminal."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path

import torch
from rich.console import Console

from pcore.cli.console import say
from pcore.cli.eval_results import NO_LPIPS
from pcore.cli.layout import Column, Sheet, room, sheet_lines
from pcore.cli.sweep import SweepCommand
from pcore.cli.sweep_forecast import show_plan
from pcore.cli.sweep_places import placed, with_contents
from pcore.cli.sweep_verbs import check_trials, output_folder, run_trial
from pcore.demo.machine import clock, usable_cores
from pcore.errors import InputError, TrainingError
from pcore.evaluation.tables import shown
from pcore.files.lock import FolderLock
from pcore.sweep.executors import (
    Execute,
    Machine,
    check_resources,
    check_workers,
    in_turn,
    machines_of,
    on_ray,
    this_machine,
    trials_at_once,
)
from pcore.sweep.spread import (
    PairedDifference,
    Spread,
    VariantMean,
    paired_differences,
    variant_means,
)
from pcore.sweep.storage_claim import claimed
from pcore.sweep.sweep_plan import ALL, SweepPlan, read_plan
from pcore.sweep.sweep_scores import notes_of, scores_of
from pcore.sweep.sweep_storage import check_storage, publish
from pcore.sweep.sweep_tables import SWEEP_FILE, TABLES, write_sweep
from pcore.sweep.sweep_trial import (
    OUTPUT_FILE,
    Trial,
    TrialResult,
    check_inputs,
    fetch_records,
    finished_trial,
    trials_of,
)
from pcore.validation import check_count

_COLUMNS = (
    ("foreground_psnr", "fg PSNR\ndB", 2, 1),
    ("psnr", "PSNR\ndB", 2, 1),
    ("ssim", "SSIM", 4, 1),
    ("lpips_vgg", "LPIPS\nvgg", 4, 1),
    ("hole_rate", "holes\n%", 2, 100),
    ("depth_error_relative", "depth error\n%", 2, 100),
)
"""Metric, heading, digits, factor; the files have all metrics."""
_SHOWN = "standard"


def write_results(
    folder: Path, trials: Sequence[Trial], results: Sequence[TrialResult]
) -> tuple[list[VariantMean], list[PairedDifference], int]:
    """Gather the scores of the trials that have finished so far, and write the files.

    Returns:
        Means, differences, and how many seeds there are.
    """
    scores = scores_of([one.trial for one in results if one.failed is None])
    means, differences = variant_means(scores), paired_differences(scores)
    write_sweep(folder, results, scores, means, differences, trials=len(trials))
    return means, differences, len({one.seed for one in scores})


def show_results(
    console: Console, folder: Path, trials: Sequence[Trial], results: Sequence[TrialResult]
) -> None:
    """Write the files and print the tables."""
    means, differences, seeds = write_results(folder, trials, results)
    for sheet in (_mean_sheet(means, seeds), _difference_sheet(differences)):
        if sheet.rows:
            say(console, *sheet_lines(_filled(sheet), room(console)), "")
    finished = [one.trial for one in results if one.failed is None]
    say(console, *[f"note: {note}" for note in _once(notes_of(finished))])
    say(console, f"written to {folder}")


def _once(notes: Sequence[str]) -> list[str]:
    """Notes of trials, where what a machine lacks, not a trial, is told once and of no trial."""
    parts = [(note, note.partition(": ")[2]) for note in notes]
    return [*dict.fromkeys(said if said.startswith(NO_LPIPS) else note for note, said in parts)]


def show_failures(console: Console, failures: Sequence[TrialResult]) -> None:
    """List failed trials, each with its reason and where its whole output is."""
    say(console, f"failed: {len(failures)}")
    for one in failures:
        told = f"  {one.trial.name}: {one.failed} ({one.trial.folder / OUTPUT_FILE})"
        say(console, told)


def _mean_sheet(means: Sequence[VariantMean], seeds: int) -> Sheet:
    """Means over scenes where there are any, else of each scene."""
    chosen = [one for one in means if one.protocol == _SHOWN]
    over = {(one.setting, one.method, one.state) for one in chosen if one.scene == ALL}
    rows = tuple(
        ((one.setting, one.method, one.scene, one.state), _figures(one.figures))
        for one in chosen
        if one.scene == ALL or (one.setting, one.method, one.state) not in over
    )
    return Sheet(
        title=f"protocol {_SHOWN}: mean ± standard deviation over {seeds} seeds",
        keys=("setting", "method", "scene", "state"),
        columns=tuple(heading for _, heading, _, _ in _COLUMNS),
        rows=rows,
    )


def _difference_sheet(differences: Sequence[PairedDifference]) -> Sheet:
    rows = tuple(
        (
            (f"{one.setting}: {one.method}", f"{one.against[0]}: {one.against[1]}", one.state),
            _figures(one.figures, sign=True),
        )
        for one in differences
        if one.protocol == _SHOWN
    )
    return Sheet(
        title="paired differences (same scene and seed): mean ± standard deviation over pairs",
        keys=("variant", "minus", "state"),
        columns=tuple(heading for _, heading, _, _ in _COLUMNS),
        rows=rows,
    )


def _filled(sheet: Sheet) -> Sheet:
    """Without columns that say nothing in any row."""
    kept = [k for k in range(len(sheet.columns)) if any(v[k] != shown(None) for _, v in sheet.rows)]
    rows = tuple((keys, tuple(values[k] for k in kept)) for keys, values in sheet.rows)
    return replace(sheet, columns=tuple(sheet.columns[k] for k in kept), rows=rows)


def _figures(figures: Mapping[str, Spread], *, sign: bool = False) -> Column:
    return tuple(_text(figures.get(name), digits, k, sign) for name, _, digits, k in _COLUMNS)


def _text(one: Spread | None, digits: int, factor: float, sign: bool) -> str:
    if one is None:
        return shown(None)
    plus = "+" if sign and one.mean > 0 else ""
    text = plus + shown(factor * one.mean, digits)
    return text if one.spread is None else f"{text} ± {factor * one.spread:.{digits}f}"


def sweep(command: SweepCommand, console: Console) -> None:
    """Check everything, run what is not finished, write and print the tables."""
    plan = read_plan(command.plan)
    beside = command.plan.parent
    trials = trials_of(plan, beside=beside, folder=command.output, storage=command.storage)
    trials = placed(trials, beside)
    check_trials(trials)
    trials = with_contents(trials)
    if command.storage is not None:
        check_storage(command.storage)
    with ExitStack() as stack:
        if command.dry_run:
            at_once = _at_once(command, plan)
            show_plan(console, trials, _known(trials), at_once)
            return
        if command.storage is not None:
            stack.enter_context(claimed(command.storage))
        execute = _executor(command, plan, stack)
        output_folder(command.output, SWEEP_FILE)
        lock = FolderLock.acquire(command.output)
        stack.callback(lock.release)
        if not (command.output / SWEEP_FILE).is_file():
            # The lock stays: without this, a stop while records come would leave a folder that
            # the same command takes for somebody else's.
            write_results(command.output, trials, [])
        for one in trials:
            fetch_records(one)
            check_inputs(one)
        results = _attempt(console, command.output, trials, execute)
        failures = [one for one in results if one.failed is not None]
        show_results(console, command.output, trials, results)
        if command.storage is not None:
            publish(command.output, command.storage, TABLES)
    if failures:
        show_failures(console, failures)
        raise TrainingError(
            f"{len(failures)} of {len(trials)} trials failed, the others are finished: "
            f"{', '.join(one.trial.name for one in failures)}; mend what they say, then give the "
            "same command again"
        )


def _known(trials: Sequence[Trial]) -> list[TrialResult]:
    """Finished trials, also those that only the storage knows of; writes nothing beside them."""
    found: list[TrialResult | None] = []
    with tempfile.TemporaryDirectory() as folder:
        for number, one in enumerate(trials):
            place = one.folder if one.storage is None else Path(folder) / str(number)
            fetch_records(one, place)
            check_inputs(one, place)
            found.append(finished_trial(one, place) or finished_trial(one, one.folder))
    return [one for one in found if one is not None]


def _at_once(command: SweepCommand, plan: SweepPlan) -> int:
    """How many trials run at a time; InputError where none could."""
    _check_options(command)
    _check_here(command, plan)
    if command.address is None:
        return command.workers or 1
    return trials_at_once(plan.resources, machines_of(command.address))


def _check_options(command: SweepCommand) -> None:
    if command.workers is not None:
        check_count("--workers", command.workers)
    if command.workers is not None and command.address is not None:
        raise InputError(
            f"--workers {command.workers}: expected no number with --address, whose cluster has "
            "its own; leave one of the options out"
        )


def _check_here(command: SweepCommand, plan: SweepPlan) -> None:
    """Check resources against this machine, unless others do the work."""
    if command.address is None:
        check_resources(plan.resources, [_machine()])
        check_workers(plan.resources, command.workers or 1, _machine())


def _executor(command: SweepCommand, plan: SweepPlan, stack: ExitStack) -> Execute:
    _check_options(command)
    _check_here(command, plan)
    if command.workers is None and command.address is None:
        return in_turn
    ray = on_ray(
        plan.resources,
        address=command.address,
        workers=command.workers or 1,
        machine=_machine(),
    )
    return stack.enter_context(ray)


def _machine() -> Machine:
    """This one."""
    return this_machine(usable_cores(), torch.cuda.device_count())


def _attempt(
    console: Console, folder: Path, trials: Sequence[Trial], execute: Execute
) -> list[TrialResult]:
    """Results of all trials, in their order; the files are written anew after each of them."""
    done = [one for one in map(finished_trial, trials) if one is not None]
    results = {one.trial.name: one for one in done}
    if done:
        say(console, f"{len(done)} of {len(trials)} trials are finished already")
    left = [one for one in trials if one.name not in results]

    def so_far() -> list[TrialResult]:
        return [results[one.name] for one in trials if one.name in results]

    write_results(folder, trials, so_far())
    for result in execute(left, run_trial):
        fetch_records(result.trial)
        results[result.trial.name] = result
        with suppress(InputError, OSError):  # At the end it is said.
            write_results(folder, trials, so_far())
        took = "" if result.seconds is None else f" in {clock(result.seconds)}"
        said = f"finished{took}" if result.failed is None else f"failed: {result.failed}"
        say(console, f"{len(results)}/{len(trials)} {result.trial.name}: {said}")
    return so_far()
