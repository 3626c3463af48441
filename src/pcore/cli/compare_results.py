"""`pcore compare`: who is compared on what; lines while it works, files, tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from pcore.asset.neural_points import NeuralPoints
from pcore.cli.compare import CompareCommand
from pcore.cli.console import say
from pcore.cli.eval_results import missing_lpips
from pcore.cli.export_field import export_field
from pcore.cli.layout import Sheet, room, sheet_lines
from pcore.cli.options import named_paths
from pcore.cli.output import results_folder
from pcore.cli.runtime import pick_device, prepare_torch
from pcore.cli.torchrun import joined_ranks, refuse_ranks
from pcore.data.scene import check_images
from pcore.errors import InputError
from pcore.evaluation.contest import Contest, Entry, Outcome
from pcore.evaluation.contest_tables import (
    COMPARE_FILE,
    COSTS,
    Line,
    contest_csv,
    contest_record,
    cost_rows,
    images_csv,
    known,
    lines_of,
    markdown,
    quality_rows,
)
from pcore.evaluation.contestants import METHODS, Given, given_entries, needed, stamp_of_run
from pcore.evaluation.methods import open_subject
from pcore.evaluation.motion_method import has_end_views, motion_entries
from pcore.evaluation.picture_entries import picture_entries
from pcore.evaluation.protocol import load_perceptual
from pcore.evaluation.rival_entries import Workshop
from pcore.evaluation.runner import mean
from pcore.evaluation.states import SceneStates, State, open_states
from pcore.evaluation.tables import IMAGES_FILE, shown, write_json
from pcore.files.atomic import write_atomically
from pcore.files.provenance import made_by
from pcore.files.run_record import relative
from pcore.rivals.motion_stages import MotionConfig
from pcore.training.presets import gaussian_preset, preset
from pcore.training.ranks import Ranks
from pcore.validation import check_count

CSV_FILE, TABLES_FILE = "compare.csv", "compare.md"


def teller(console: Console, total: int) -> Callable[[Outcome], None]:
    """Prints a line for every outcome."""
    done = [0]

    def tell(outcome: Outcome) -> None:
        done[0] += 1
        psnr = mean([row.scores.get("foreground_psnr") for row in outcome.rows])
        said = f"{shown(psnr)} dB" if outcome.failed is None else f"failed: {outcome.failed}"
        seed = f", seed {outcome.seed}" if outcome.seed else ""
        line = (
            f"{done[0]}/{total} {outcome.name} ({outcome.setting}{seed}), {outcome.state}: {said}"
        )
        say(console, line)

    return tell


def finish(
    console: Console,
    output: Path,
    outcomes: Sequence[Outcome],
    states: Sequence[str],
    *,
    about: dict[str, Any],
    notes: Sequence[str],
) -> None:
    """Write the files and print the tables.

    Args:
        console: where to.
        output: folder of the results.
        outcomes: of all methods.
        states: their names, in the order of the columns.
        about: what was compared, for the file.
        notes: what a reader has to know besides failures.
    """
    lines = lines_of(outcomes, "standard")
    failures = [f"{line.name}, {s}: {why}" for line in lines for s, why in line.failed.items()]
    said = [*notes, *failures]
    record = contest_record(lines, about=about, notes=said)
    write_json(output / COMPARE_FILE, {**record, "status": "finished"})
    write_atomically(output / CSV_FILE, contest_csv(lines))
    write_atomically(output / IMAGES_FILE, images_csv(outcomes))
    text = _tables(console, lines, states)
    text += "".join(f"- {line}\n" for line in said)
    write_atomically(output / TABLES_FILE, text.encode())
    for line in said:
        say(console, f"note: {line}")
    say(console, f"written to {output}")
    if all(one.failed is not None for one in outcomes):
        raise InputError(
            f"{output}: expected a method that can be scored, got failures only; mend what the "
            "notes say, then give the same command again"
        )


_SHOWN = (
    ("foreground PSNR, dB", "foreground_psnr", 2, False),
    ("PSNR of whole images, dB", "psnr", 2, False),
    ("SSIM", "ssim", 3, False),
    ("LPIPS of AlexNet", "lpips_alex", 3, False),
    ("holes", "hole_rate", 1, True),
    ("depth error, of the object's size", "depth_error_relative", 1, True),
    ("spill, of the object's pixels", "spill_to_object", 1, True),
)
"""Title, metric, digits, whether in percent."""


def _tables(console: Console, lines: Sequence[Line], states: Sequence[str]) -> str:
    """Print the tables; return them for a document."""
    tables: list[tuple[str, tuple[str, ...], Any]] = [
        (title, tuple(states), quality_rows(lines, states, metric, digits, percent=percent))
        for title, metric, digits, percent in _SHOWN
        if known(lines, metric)
    ]
    tables.append(("cost", COSTS, cost_rows(lines)))
    text = ""
    for title, heads, rows in tables:
        sheet = Sheet(title=title, keys=("method", "setting"), columns=heads, rows=tuple(rows))
        say(console, *sheet_lines(sheet, room(console)), "")
        text += markdown(title, heads, rows) + "\n"
    return text


def compare(command: CompareCommand, console: Console) -> None:
    """Train, move, draw, score, write and print; processes of torchrun take methods in turn."""
    prepare_torch(command.threads)
    device = pick_device(command.device)
    runs = _runs(command, device)
    places, states = _places(command, runs)
    if command.export_field is not None:
        refuse_ranks("--export-field")
        assets = [one.asset for one in runs]
        given = named_paths("--points", command.points)
        export_field(console, command.export_field, assets, given, (places, states))
        return
    with joined_ranks(device, learns=False) as ranks:
        _compare(command, console, device, ranks, runs, (places, states))


def _compare(
    command: CompareCommand,
    console: Console,
    device: str,
    ranks: Ranks,
    runs: Sequence[Given],
    where: tuple[SceneStates, Sequence[State]],
) -> None:
    places, states = where
    output = ranks.from_first(_output(command, runs, places) if ranks.rank == 0 else Path())
    entries = _entries(command, console, output, runs, where, device)
    asked = [(one.name, one.setting, one.seed, one.stamp) for one in entries]
    ranks.agree({"methods": asked, "states": [(one.name, len(one.shots)) for one in states]})
    perceptual = load_perceptual()
    contest = Contest(
        folder=output,
        states=states,
        stamp=[str(places.path.resolve()), places.factor, command.every],
        perceptual=perceptual,
    )
    outcomes = contest.run(entries, teller(console, len(entries) * len(states)))
    if ranks.rank > 0:
        return
    about = {**_about(command, places, states, output), "made_by": made_by(device)}
    names = [state.name for state in states]
    notes = [*([places.left_out] if places.left_out else []), *missing_lpips(perceptual)]
    finish(console, output, outcomes, names, about=about, notes=notes)


def _runs(command: CompareCommand, device: str) -> list[Given]:
    if len({path.resolve() for path in command.runs}) < len(command.runs):
        raise InputError(
            f"compare: expected each RUN once, got {' '.join(map(str, command.runs))}; leave the "
            "copies out"
        )
    return [
        Given(asset=open_subject(path, device=device), stamp=stamp_of_run(path))
        for path in command.runs
    ]


def _places(command: CompareCommand, runs: Sequence[Given]) -> tuple[SceneStates, list[State]]:
    """The scene and its states, with the test views that are wanted."""
    check_count("--every", command.every)
    if not runs and command.scene is None:
        raise InputError("compare: expected a RUN, or the folder of a scene with --scene, got none")
    record = runs[0].asset.record if runs else None
    path = command.scene if record is None else record.scene_or(command.scene)
    assert path is not None
    for run in runs:
        other = run.asset.record.scene_folder
        if other is not None and other.resolve() != path.resolve():
            raise InputError(
                f"{run.asset.path} was trained on {other}: expected runs of one scene, {path}; "
                "compare them apart"
            )
    factor = (record.factor if record else 1) if command.factor is None else command.factor
    places = open_states(path, factor=factor)
    states = [replace(s, shots=s.shots[:: command.every]) for s in places.select(command.state)]
    check_images(shot.view for state in states for shot in state.shots)
    return places, states


def _output(command: CompareCommand, runs: Sequence[Given], places: SceneStates) -> Path:
    """The folder for results: new, empty, or of an earlier comparison on this scene."""
    if command.output is None and not runs:
        raise InputError("compare: expected a folder for the results with -o, as no RUN is given")
    output = command.output or runs[0].asset.path / "compare"
    results_folder(output, COMPARE_FILE, about=places.path)
    return output


def _entries(
    command: CompareCommand,
    console: Console,
    output: Path,
    runs: Sequence[Given],
    where: tuple[SceneStates, Sequence[State]],
    device: str,
) -> list[Entry]:
    places, states = where
    wanted = wanted_methods(command.methods)
    if command.seconds <= 0:
        raise InputError(f"--seconds: expected more than 0, got {command.seconds}")
    counts = [len(one.asset) for one in runs if isinstance(one.asset.content, NeuralPoints)]
    shop = Workshop(
        folder=output / "trained",
        scene=places.scene,
        config=gaussian_preset("tiny"),
        points=preset("tiny"),
        primitives=counts[0] if counts else preset("tiny").points,
        seconds=command.seconds,
        device=device,
        note=lambda text: say(console, f"training: {text}"),
    )
    entries = given_entries(runs, places.scene, wanted)
    # Of "all" where it can learn at all; asked for by name it says what is missing.
    if "motion" in command.methods or ("motion" in wanted and has_end_views(places, states)):
        config = MotionConfig(steps=command.motion_steps)
        entries += motion_entries(runs, places, output / "trained", config)
    entries += shop.entries(wanted, command.settings, command.seeds)
    entries += picture_entries(named_paths("--pictures", command.pictures), entries)
    if not entries:
        lacking = "; ".join(f"{name} needs {needed(name)}" for name in wanted)
        raise InputError(
            f"--methods {' '.join(command.methods)}: expected a method that can be compared, got "
            f"none: {lacking or 'give pictures of other code with --pictures NAME=DIR'}"
        )
    return entries


def wanted_methods(names: Sequence[str]) -> list[Any]:
    """Methods of names that were given, in the order of the tables; InputError for others."""
    unknown = [name for name in names if name not in (*METHODS, "all", "none")]
    if unknown:
        raise InputError(
            f"--methods: expected some of {', '.join(METHODS)}, all or none, got "
            f"{', '.join(unknown)}"
        )
    return [*METHODS] if "all" in names else [name for name in METHODS if name in names]


def _about(
    command: CompareCommand, places: SceneStates, states: Sequence[State], output: Path
) -> dict[str, Any]:
    """What is compared, for the file of results."""
    return {
        "run": relative(places.path, output),
        "kinds": {state.name: state.kind for state in states},
        "factor": places.factor,
        "every": command.every,
        "seconds": command.seconds,
        "seeds": [*command.seeds],
        "runs": [relative(path, output) for path in command.runs],
    }
