"""What a trial of a sweep runs: the ordinary commands, with the options of the plan."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Collection, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

from pcore.capture.load import load_scene
from pcore.cli.compare import CompareCommand
from pcore.cli.compare_results import wanted_methods
from pcore.cli.eval import EvalCommand
from pcore.cli.eval_results import given_edits
from pcore.cli.main import VERBS, Command, command_of
from pcore.cli.output import pictures_folder
from pcore.cli.sweep_processes import TORCHRUN, run_together
from pcore.cli.train import TrainCommand
from pcore.cli.training import train_config
from pcore.errors import EditError, InputError, SceneError
from pcore.evaluation.states import open_states
from pcore.files.run_place import bytes_needed, check_space
from pcore.files.run_record import begun
from pcore.sweep.sweep_scores import COMPARE, EVAL
from pcore.sweep.sweep_trial import Trial
from pcore.validation import check_count

RUN, TUNED = "run", "tuned"
"""Folders of a trial's trainings."""
_OURS = {
    "train": {"scene", "output", "o", "seed", "resume", "device", "threads"},
    "finetune": {"run-folder", "output", "o", "scene", "seed", "resume", "device", "threads"},
    "eval": {"run-folder", "output", "o", "scene", "device", "threads"},
    "compare": {"runs", "output", "o", "scene", "seeds", "device", "threads", "export-field"},
}
"""Options that a plan cannot give, because every trial has its own."""


def run_trial(trial: Trial) -> None:
    """Run the verbs of a trial one after another; trainings go on from what lies in its folder."""
    for verb in trial.verbs:
        if trial.processes > 1:
            run_together(process_words(trial, verb))
        else:
            parsed(trial, verb).run()


def parsed(trial: Trial, verb: str) -> Command:
    """One command of a trial, ready to run."""
    where = f"plan: setting {trial.setting!r}, {verb}"
    words = [*_own_words(trial, verb), *_plan_words(trial, verb, where)]
    return parsed_words(verb, words, where)


def parsed_words(verb: str, words: Sequence[str], where: str) -> Command:
    """The command of a verb with options as on the command line."""
    known = {one.name: one for one in VERBS}
    if verb not in known:
        raise InputError(f"{where}: this pcore has no verb {verb!r}")
    told = io.StringIO()
    try:
        with redirect_stderr(told), redirect_stdout(told):
            return command_of(known[verb], words)
    except SystemExit as error:
        # Without title and frame of what a terminal shows, and its hint, which follows here anyway.
        text = re.sub(r"[^\x20-\x7e]|-{3,}", " ", told.getvalue().strip().partition("\n")[2])
        reason = " ".join(text.partition("For full helptext")[0].split())
        raise InputError(f"{where}: {reason}; `pcore {verb} --help` has all options") from error


def words_of(trial: Trial, verb: str) -> list[str]:
    """The same command as words of a command line."""
    start = [*TORCHRUN, str(trial.processes), "--no-python"] if trial.processes > 1 else []
    return [*start, "pcore", verb, *_own_words(trial, verb), *_plan_words(trial, verb, verb)]


def process_words(trial: Trial, verb: str) -> list[str]:
    """The same command as a process of its own that starts with this Python."""
    words = words_of(trial, verb)
    command = ["pcore.cli.main", *words[words.index("pcore") + 1 :]]
    if trial.processes > 1:
        command = ["pcore.cli.sweep_processes", str(trial.processes), *command]
    return [sys.executable, "-m", *command]


def check_trials(trials: Sequence[Trial]) -> None:
    """Refuse what can be known to be wrong before anything starts.

    Args:
        trials: all of the sweep; every setting and every scene is checked once.

    Raises:
        InputError: an unknown option or state, or scenes that are missing or damaged, all of them.
    """
    commands = {one.setting: {verb: parsed(one, verb) for verb in one.verbs} for one in trials}
    processes = {one.setting: one.processes for one in trials}
    for setting, verbs in commands.items():
        for verb, command in verbs.items():
            _check_values(command, f"plan: setting {setting!r}, {verb}", processes[setting])
    wrong: dict[str, str] = {}
    for one in {(one.scene, one.setting): one for one in trials}.values():
        try:
            _check_scene(one.scene_folder, commands[one.setting])
        except (InputError, SceneError) as error:
            wrong.setdefault(one.scene, f"scene {one.scene!r}, setting {one.setting!r}: {error}")
    if len(wrong) == 1:
        raise InputError(f"plan: {next(iter(wrong.values()))}")
    if wrong:
        told = "".join(f"\n- {one}" for one in wrong.values())
        raise InputError(f"plan: {len(wrong)} scenes cannot be used:{told}")


def _check_scene(place: Path, commands: Mapping[str, Any]) -> None:
    train = commands["train"]
    load_scene(place, factor=train.factor)
    for verb in {"eval", "compare"} & {*commands}:
        scored = commands[verb]
        states = scored.state or (() if verb == "eval" and scored.edit else ("all",))
        there = open_states(place, factor=scored.factor or train.factor)
        there.select(states)
        if verb == "eval" and scored.against is not None:
            there.true_shots(scored.against)


def _check_values(command: Any, where: str, processes: int) -> None:
    """Refuse numbers, methods and edits that the verb would refuse, hours later."""
    for name in ("steps", "points", "patches", "every"):
        value = getattr(command, name, None)
        if isinstance(value, int):
            check_count(f"{where}: '{name}'", value)
    if processes > 1 and hasattr(command, "patches") and (command.patches or 1) < processes:
        raise InputError(
            f"{where}: expected at least one patch or photo of a step for each of {processes} "
            f"processes, got {command.patches or 1}; give patches: {processes} or a multiple"
        )
    try:
        if isinstance(command, TrainCommand):
            train_config(command)
        elif isinstance(command, CompareCommand):
            wanted_methods(command.methods)
        elif isinstance(command, EvalCommand):
            given_edits(command)
    except (InputError, EditError) as error:
        raise InputError(f"{where}: {error}") from None


def _own_words(trial: Trial, verb: str) -> list[str]:
    """What the sweep itself says: places, seed, resources, whether there is something to resume."""
    run, tuned = trial.folder / RUN, trial.folder / TUNED
    last = tuned if "finetune" in trial.verbs else run
    scene, seed = str(trial.scene_folder), str(trial.seed)
    shared = ["--device", trial.device, "--threads", str(trial.threads)]
    if verb in ("train", "finetune"):
        made = run if verb == "train" else tuned
        first = [scene] if verb == "train" else [str(run), "--scene", scene]
        resume = ["--resume"] if begun(made) else []
        return [*first, "--output", str(made), "--seed", seed, *shared, *resume]
    folder = trial.folder / (EVAL if verb == "eval" else COMPARE)
    seeds = [] if verb == "eval" else ["--seeds", seed]
    subjects = [str(last)] if verb == "eval" else [str(one) for one in dict.fromkeys((run, last))]
    return [*subjects, "--scene", scene, "--output", str(folder), *seeds, *shared]


def _plan_words(trial: Trial, verb: str, where: str) -> list[str]:
    verbs: Mapping[Any, Mapping[str, Any]] = trial.verbs
    return option_words(verbs[verb], _OURS[verb], where, giver="sweep")


def option_words(
    options: Mapping[str, Any], ours: Collection[str], where: str, *, giver: str
) -> list[str]:
    """Options of a file as words; true is a flag that is given, false one that is not.

    Args:
        options: name -> value, or list of values, with or without dashes.
        ours: names that the file cannot give.
        where: the place in the file, for messages.
        giver: what gives ours, such as "sweep".
    """
    found: list[str] = []
    for key, value in options.items():
        name = key.replace("_", "-").lstrip("-")
        if name in ours:
            raise InputError(
                f"{where}: '{key}': expected options that are the same for all, got one that the "
                f"{giver} gives to each; remove it (seeds, resources and files have their own keys)"
            )
        if value is None or isinstance(value, dict):
            raise InputError(f"{where}: '{key}': expected a value or a list, got {value!r}")
        if isinstance(value, list):
            found += [f"--{name}", *map(str, value)]
        elif not isinstance(value, bool):
            found.append(f"--{name}={value}")
        elif value:
            found.append(f"--{name}")
    return found


def output_folder(folder: Path, file: str) -> None:
    """Make the folder of a sweep; refuse one that holds something else."""
    check_space(folder, bytes_needed(0))
    pictures_folder(folder, overwrite=(folder / file).is_file() or None)
