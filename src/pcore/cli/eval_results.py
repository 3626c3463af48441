"""`pcore eval`: what is scored, and results of evaluations in the terminal."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from pcore.asset.asset import Asset
from pcore.asset.posing import script_of
from pcore.cli.console import counting, say
from pcore.cli.diagnosing import note
from pcore.cli.eval import EvalCommand
from pcore.cli.layout import Sheet, room, sheet_lines
from pcore.cli.options import check_given_samples
from pcore.cli.output import results_folder
from pcore.cli.runtime import pick_device, prepare_torch
from pcore.cli.torchrun import joined_ranks
from pcore.data.scene import check_images
from pcore.editing.script import EditScript
from pcore.errors import InputError
from pcore.evaluation.edited import EditedShape
from pcore.evaluation.figures import png_bytes
from pcore.evaluation.methods import baseline_of, mended_notes, methods_of, open_subject
from pcore.evaluation.panels import comparison_sheet
from pcore.evaluation.protocol import PROTOCOLS, Perceptual, load_perceptual
from pcore.evaluation.runner import ImageRow, Method, Taken, evaluate
from pcore.evaluation.states import CANONICAL, SceneStates, State, open_states
from pcore.evaluation.summary import Gain, StateMean, gains, state_means
from pcore.evaluation.tables import SUMMARY_FILE, shown, summary_record, write_tables
from pcore.files.atomic import write_atomically
from pcore.files.provenance import made_by
from pcore.files.run_record import relative
from pcore.training.ranks import Ranks

# Metric, title, digits, shown as percent. Foreground SSIM and the rest stand in the files.
_COLUMNS = (
    ("foreground_psnr", "fg\nPSNR", 2, False),
    ("psnr", "\nPSNR", 2, False),
    ("ssim", "\nSSIM", 3, False),
    ("lpips_alex", "LPIPS\nalex", 3, False),
    ("lpips_squeeze", "LPIPS\nsqueeze", 3, False),
    ("lpips_vgg", "LPIPS\nvgg", 3, False),
    ("hole_rate", "\nholes", 1, True),
    ("see_through_rate", "see-\nthrough", 1, True),
    ("depth_error_relative", "depth\nerror", 2, True),
    ("spill_to_object", "\nspill", 1, True),
)

_HEALTH = (
    ("strain_median", "strain\nmedian", 2, False),
    ("strain_99", "strain\n99 %", 2, False),
    ("strain_max", "strain\nmost", 2, False),
    ("self_intersection", "self-\nintersection", 1, True),
    ("unseen", "\nunseen", 1, True),
)

_HOLES = (
    ("hole_score", "hole\nscore", 1, True),
    ("hole_score_plain", "the same,\nplain rays", 1, True),
    ("anchors_disagree", "anchors\ndisagree", 1, True),
    ("without_handle", "no handle\nnear", 1, True),
)


def show_results(
    console: Console,
    means: Sequence[StateMean],
    gains: Sequence[Gain],
    *,
    perceptual: Perceptual | None,
    notes: Sequence[str] = (),
) -> None:
    """Print tables of every protocol and of the points, the gains, and why columns are missing."""
    for protocol in dict.fromkeys(one.protocol for one in means):
        chosen = [one for one in means if one.protocol == protocol]
        # A state that an edit file makes has true images only where it is scored against another.
        scored = [one for one in chosen if one.scores.get("psnr") is not None]
        sheet = _sheet(f"protocol {protocol}", scored, _COLUMNS)
        say(console, *sheet_lines(sheet, room(console)))
        say(console, _caption(protocol, chosen), style="dim")
        for gain in gains:
            if gain.protocol == protocol:
                say(console, gain_text(gain))
        console.print()
    _show_health(console, means)
    for line in [*notes, *missing_lpips(perceptual)]:
        say(console, f"note: {line}")


NO_LPIPS = "no LPIPS with "
"""How the note of `missing_lpips` begins, which is of the machine and not of what it runs."""


def missing_lpips(perceptual: Perceptual | None) -> list[str]:
    """Say why columns of LPIPS are empty; nothing where none is."""
    missing = ", ".join(perceptual.missing) if perceptual is not None else ""
    why = f"{NO_LPIPS}{missing}: no weights; `pcore doctor --weights` says what goes where"
    return [why] if missing else []


def gain_text(gain: Gain) -> str:
    """One sentence per figure of a comparison, for people."""
    parts = [
        f"{gain.method} against {gain.baseline}, mean of the {gain.group} states "
        f"({', '.join(gain.states)}):",
        f"  foreground PSNR {_signed(gain.gain)} dB; {gain.baseline} loses "
        f"{shown(gain.lost)} dB there, recovered {shown(gain.recovered, 0, percent=True)}",
        f"  additional holes {shown(gain.baseline_holes, 1, percent=True)} -> "
        f"{shown(gain.method_holes, 1, percent=True)}, removed "
        f"{shown(gain.holes_removed, 0, percent=True)}",
        f"  canonical loss {shown(gain.canonical_loss)} dB foreground, "
        f"{shown(gain.canonical_loss_full)} dB whole image",
    ]
    return "\n".join(parts)


def _show_health(console: Console, means: Sequence[StateMean]) -> None:
    """The points themselves, which are the same under every protocol."""
    chosen = [one for one in means if one.protocol == means[0].protocol]
    if any(one.scores.get("strain_99") is not None for one in chosen):
        for title, known in (("points", _HEALTH), ("points, holes and handles", _HOLES)):
            sheet = _sheet(title, chosen, known)
            if sheet.columns:
                say(console, *sheet_lines(sheet, room(console)))
        said = "unseen: share of the object's pixels that show what no training view saw"
        say(console, said, style="dim")
        console.print()


def _sheet(
    title: str, means: Sequence[StateMean], known: Sequence[tuple[str, str, int, bool]]
) -> Sheet:
    columns = [c for c in known if any(one.scores.get(c[0]) is not None for one in means)]
    rows = tuple(
        (
            (one.state, one.method),
            tuple(shown(one.scores.get(key), n, percent=p) for key, _, n, p in columns),
        )
        for one in means
    )
    headings = tuple(heading for _, heading, _, _ in columns)
    return Sheet(title=title, keys=("state", "method"), columns=headings, rows=rows)


def _caption(protocol: str, means: Sequence[StateMean]) -> str:
    views = sorted({one.views for one in means})
    known = PROTOCOLS.get(protocol)
    count = " or ".join(map(str, views))
    return f"{known.description if known else protocol}; means over {count} test views"


def _signed(value: float | None) -> str:
    text = shown(value)
    return f"+{text}" if value is not None and value > 0 else text


PICTURES = "pictures"


def evaluate_run(command: EvalCommand, console: Console) -> None:
    """Score the run, write the files and print the table.

    The processes that torchrun started take turns at the pictures; the first of them has the table.
    """
    check_given_samples(command.samples)
    prepare_torch(command.threads)
    device = pick_device(command.device)
    with joined_ranks(device, learns=False) as ranks:
        _evaluate(command, device, ranks, console)


def _evaluate(command: EvalCommand, device: str, ranks: Ranks, console: Console) -> None:
    run = open_subject(command.run_folder, device=device)
    base = baseline_of(run, command.baseline, device=device)
    runs = [run] if base is None else [base, run]
    factor = run.record.factor if command.factor is None else command.factor
    masks = run.record.masks if command.scene is None else None
    places = open_states(run.record.scene_or(command.scene), factor=factor, masks=masks)
    states = places.select(command.state or (() if command.edit else ("all",)))
    edited, odd = _edited(command, places, runs)
    states += edited
    note(console, places.scene.notes)
    check_images(shot.view for state in states for shot in state.shots)
    output = command.output or command.run_folder / "eval"
    points = {one.path.name: one.points for one in runs}
    ranks.agree({**points, "states": [(one.name, len(one.shots)) for one in states]})
    if ranks.rank == 0:
        results_folder(output, SUMMARY_FILE, about=run.path)
    ranks.from_first(output)  # Nobody draws before the folder is there.
    methods = methods_of(
        runs,
        places.scene,
        rays=command.rays,
        light=command.light,
        take=lambda asset, posed, camera: asset.render(posed, camera, samples=command.samples),
    )
    chosen = PROTOCOLS.values() if command.protocol == "both" else [PROTOCOLS[command.protocol]]
    perceptual = load_perceptual()
    with counting(console, "pictures") as tell:
        rows = evaluate(
            methods,
            states,
            protocols=list(chosen),
            perceptual=perceptual,
            progress=tell,
            show=_sheet_writer(output / PICTURES, methods) if command.pictures else None,
        )
    if ranks.rank > 0:
        return
    counts = [one.content.samples for one in runs]
    if command.samples is None and len({*counts}) > 1:
        odd.append("the runs send another number of rays per pixel each; give --samples for one")
    left_out = [places.left_out] if places.left_out else []
    notes = [*left_out, *odd, *mended_notes(rows, methods, states)]
    about = {**_about(command, runs, places, output), "made_by": made_by(device)}
    finish(console, output, rows, about=about, perceptual=perceptual, notes=notes)


def _about(
    command: EvalCommand, runs: Sequence[Asset], places: SceneStates, output: Path
) -> dict[str, Any]:
    """What the results are of, for their file; the baseline comes before the run."""
    base = None if len(runs) == 1 else relative(runs[0].path, output)
    return {
        "run": relative(runs[-1].path, output),
        "baseline": base,
        "scene": relative(places.path, output),
        "factor": places.factor,
        "samples": {one.path.name: command.samples or one.content.samples for one in runs},
        **({} if command.against is None else {"against": command.against}),
    }


def _edited(
    command: EvalCommand, places: SceneStates, runs: Sequence[Asset]
) -> tuple[list[State], list[str]]:
    """States of the edit files, and what is odd about them."""
    subjects = [(one.points, one.rig) for one in runs]
    states: list[State] = []
    odd: list[str] = []
    for file, script in given_edits(command).items():
        name, shape = file.stem, EditedShape(script, subjects)
        if command.against is None:
            shots = places.select([CANONICAL])[0].shots
            states.append(shape.state(name, shots, places.scene.center))
        else:
            shots, size = places.true_shots(command.against), places.size_in(command.against)
            states.append(shape.against(name, shots, size))
        odd += [f"{file}: {line}" for line in shape.notes]
    return states, odd


def given_edits(command: EvalCommand) -> dict[Path, EditScript]:
    """Read the edit files.

    Raises:
        InputError: two of one name, or none where one is to be scored.
        EditError: a file that is no edit, or no `--time` for one that moves.
    """
    names = [file.stem for file in command.edit]
    if len({*names}) < len(names):
        raise InputError(
            f"--edit: expected files of different names, got {', '.join(map(str, command.edit))}"
        )
    if command.against is not None and not names:
        raise InputError("--against: expected --edit FILE, which is to be scored, got none")
    return {file: script_of(file, command.time) for file in command.edit}


def finish(
    console: Console,
    output: Path,
    rows: Sequence[ImageRow],
    *,
    about: Mapping[str, Any],
    perceptual: Perceptual,
    notes: Sequence[str] = (),
) -> None:
    """Write rows and summary and print the table; the first method is the baseline."""
    means = state_means(rows)
    found = gains(means, means[0].method)
    record = summary_record(means, found, about=about, perceptual=perceptual, notes=notes)
    write_tables(output, rows, record)
    show_results(console, means, found, perceptual=perceptual, notes=notes)
    say(console, f"written to {output}")


def _sheet_writer(folder: Path, methods: Sequence[Method]) -> Callable[[Taken], None]:
    folder.mkdir(parents=True, exist_ok=True)
    names = [method.name for method in methods]

    def write(taken: Taken) -> None:
        file = f"{taken.state}-{taken.view}.png".replace(":", "_")
        write_atomically(folder / file, png_bytes(comparison_sheet(taken, names)))

    return write
