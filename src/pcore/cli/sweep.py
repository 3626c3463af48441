"""`pcore sweep PLAN -o DIR`: train, fine-tune and score scenes x settings x seeds."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.console import Console
from rich.text import Text
from tyro.conf import Positional, arg

from pcore.cli.options import Count, optional
from pcore.errors import InputError, TrainingError
from pcore.validation import check_count

if TYPE_CHECKING:
    from pcore.sweep.executors import Execute, Machine
    from pcore.sweep.sweep_plan import SweepPlan
    from pcore.sweep.sweep_trial import Trial, TrialResult


@dataclass(frozen=True, kw_only=True)
class SweepCommand:
    """Run every scene with every setting and every seed of a plan, and gather the results.

    The same command goes on where an interrupted one stopped, and does not repeat what is
    finished. A trial that fails is listed at the end, with exit code 2, and stops no other.
    """

    plan: Annotated[Positional[Path], arg(metavar="PLAN")]
    """YAML file of scenes, settings, seeds and resources; see the guide "Sweeps"."""

    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """Folder for trials and tables; new, empty, or of the same sweep."""

    workers: Count = None
    """Trials at a time on this machine, on Ray (extra `cluster`); default: one after another in
    this process."""

    address: Annotated[str | None, optional("HOST:PORT")] = None
    """Of a running Ray cluster that shares its disks with this machine."""

    storage: Annotated[str | None, optional("URL")] = None
    """Mirror trials to this place (s3://BUCKET/FOLDER, file:///FOLDER, any of fsspec), from which
    every machine goes on: for clusters whose machines share scenes and no folder to write to."""

    dry_run: bool = False
    """Check and show the plan, and say how long it will take; trains a few seconds to know."""

    def run(self) -> None:
        """Run the plan; raises PcoreError subclasses for what the user can mend."""
        sweep(self, Console())


def sweep(command: SweepCommand, console: Console) -> None:
    """Check everything, run what is not finished, write and print the tables.

    Raises:
        InputError: a plan that is wrong, impossible resources, or a folder in use.
        SceneError: a scene cannot be read.
        DependencyError: workers without Ray.
        TrainingError: trials failed; the others are finished.
        KeyboardInterrupt: Ctrl-C; trainings have saved their state.
    """
    from pcore.cli.sweep_places import placed
    from pcore.cli.sweep_results import show_failures, show_results
    from pcore.cli.sweep_verbs import check_trials, output_folder
    from pcore.files.lock import FolderLock
    from pcore.sweep.storage_claim import claimed
    from pcore.sweep.sweep_plan import read_plan
    from pcore.sweep.sweep_storage import check_storage, publish
    from pcore.sweep.sweep_tables import SWEEP_FILE, TABLES
    from pcore.sweep.sweep_trial import fetch_records, trials_of

    plan = read_plan(command.plan)
    beside = command.plan.parent
    trials = trials_of(plan, beside=beside, folder=command.output, storage=command.storage)
    trials = placed(trials, beside)
    check_trials(trials)
    if command.storage is not None:
        check_storage(command.storage)
    with ExitStack() as stack:
        if command.dry_run:
            from pcore.cli.sweep_forecast import show_plan

            at_once = _at_once(command, plan)
            show_plan(console, trials, _known(trials), at_once)
            return
        if command.storage is not None:
            stack.enter_context(claimed(command.storage))
        execute = _executor(command, plan, stack)
        output_folder(command.output, SWEEP_FILE)
        lock = FolderLock.acquire(command.output)
        stack.callback(lock.release)
        for one in trials:
            fetch_records(one)
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
    from pcore.sweep.sweep_trial import fetch_records, finished_trial

    found: list[TrialResult | None] = []
    with tempfile.TemporaryDirectory() as folder:
        for number, one in enumerate(trials):
            place = one.folder if one.storage is None else Path(folder) / str(number)
            fetch_records(one, place)
            found.append(finished_trial(one, place) or finished_trial(one, one.folder))
    return [one for one in found if one is not None]


def _at_once(command: SweepCommand, plan: SweepPlan) -> int:
    """How many trials run at a time; InputError where none could."""
    from pcore.sweep.executors import machines_of, trials_at_once

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
    from pcore.sweep.executors import check_resources, check_workers

    if command.address is None:
        check_resources(plan.resources, [_machine()])
        check_workers(plan.resources, command.workers or 1, _machine())


def _executor(command: SweepCommand, plan: SweepPlan, stack: ExitStack) -> Execute:
    from pcore.sweep.executors import in_turn, on_ray

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
    import torch

    from pcore.demo.machine import usable_cores
    from pcore.sweep.executors import this_machine

    return this_machine(usable_cores(), torch.cuda.device_count())


def _attempt(
    console: Console, folder: Path, trials: Sequence[Trial], execute: Execute
) -> list[TrialResult]:
    """Results of all trials, in their order; the files are written anew after each of them."""
    from pcore.cli.sweep_results import write_results
    from pcore.cli.sweep_verbs import run_trial
    from pcore.demo.machine import clock
    from pcore.sweep.sweep_trial import fetch_records, finished_trial

    done = [one for one in map(finished_trial, trials) if one is not None]
    results = {one.trial.name: one for one in done}
    if done:
        console.print(f"{len(done)} of {len(trials)} trials are finished already")
    left = [one for one in trials if one.name not in results]

    def so_far() -> list[TrialResult]:
        return [results[one.name] for one in trials if one.name in results]

    write_results(folder, trials, so_far())
    for result in execute(left, run_trial):
        fetch_records(result.trial)
        results[result.trial.name] = result
        write_results(folder, trials, so_far())
        took = "" if result.seconds is None else f" in {clock(result.seconds)}"
        said = f"finished{took}" if result.failed is None else f"failed: {result.failed}"
        line = f"{len(results)}/{len(trials)} {result.trial.name}: {said}"
        console.print(Text(line), soft_wrap=True)
    return so_far()
