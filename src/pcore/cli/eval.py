"""`pcore eval RUN`: score a run on the true images of its scene, canonical and deformed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from rich.console import Console
from rich.text import Text
from tyro.conf import Positional, arg

from pcore.cli.light import LightChoice
from pcore.cli.options import (
    Count,
    Folder,
    Number,
    Output,
    Samples,
    check_given_samples,
    optional,
)
from pcore.cli.runtime import DeviceName
from pcore.cli.torchrun import is_first

if TYPE_CHECKING:
    from pcore.asset.asset import Asset
    from pcore.evaluation.protocol import Perceptual
    from pcore.evaluation.runner import ImageRow, Method, Taken
    from pcore.evaluation.states import SceneStates, State
    from pcore.training.ranks import Ranks

PICTURES = "pictures"


@dataclass(frozen=True, kw_only=True)
class EvalCommand:
    """Score a run on test views: canonical, deformed states, or an exact uniform scale.

    Writes images.csv (one line per picture) and summary.json (means and gains), and prints a
    table. A fine-tuned run is compared with the run it was tuned from, each with rays that know
    of the deformation (aware) and with plain ones.
    """

    run_folder: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of the run."""

    scene: Folder = None
    """Folder of the scene; default: the one the run was trained on."""

    state: Annotated[tuple[str, ...], arg(metavar="NAME [NAME ...]", help_behavior_hint="")] = ()
    """States besides the canonical one: names, `all`, or `scale:S` (any scene; exact truth).
    Default: all; with --edit none."""

    edit: Annotated[tuple[Path, ...], arg(metavar="FILE [FILE ...]", help_behavior_hint="")] = ()
    """Edit files, each a further state without true images: strain, holes, handles, what no view
    saw, and pictures; no PSNR."""

    against: Annotated[str | None, optional("STATE")] = None
    """With --edit: score the edits on the true test images of this state, such as `end` of a
    PAPR-in-Motion pair or a time stamp."""

    time: Number = None
    """For edit files with keyframes: the time to evaluate."""

    baseline: Folder = None
    """Run to compare with; default: the one that a fine-tuned run was tuned from."""

    rays: Literal["aware", "plain", "both"] = "both"
    """Which rays pictures of deformed states are taken with: methods with plain rays are the
    paper's."""

    light: LightChoice = None
    """still: aware rays also with a light that stands still; baked: without. Default: still for
    runs that have a light (`pcore light`)."""

    protocol: Literal["papr", "standard", "both"] = "both"
    """How images are compared: as the original PAPR does, as everybody else does, or both."""

    samples: Samples = None
    """Rays per pixel: 1, 4, 9, ...; default: those of each model."""

    output: Output = None
    """Folder for the results; default: RUN/eval."""

    pictures: bool = False
    """Also write a sheet per test view: truth, baseline and this run, with depth maps."""

    factor: Count = None
    """Down-scaling of the true images; default: that of the training."""

    device: DeviceName = "auto"
    """Where to compute; auto takes a GPU where there is one."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Evaluate; raises PcoreError subclasses for what the user can mend."""
        evaluate_run(self, Console(quiet=not is_first()))


def evaluate_run(command: EvalCommand, console: Console) -> None:
    """Score the run, write the files and print the table.

    The processes that torchrun started take turns at the pictures; the first of them has the table.

    Raises:
        CheckpointError: the run or its baseline cannot be read.
        SceneError: the scene or a state cannot be read or scored.
        EditError: an edit file is not valid or does not fit the points.
        InputError: an unknown state, a factor that does not fit, or an output folder in use.
    """
    from pcore.cli.runtime import pick_device, prepare_torch
    from pcore.cli.torchrun import joined_ranks

    check_given_samples(command.samples)
    prepare_torch(command.threads)
    device = pick_device(command.device)
    with joined_ranks(device, learns=False) as ranks:
        _evaluate(command, device, ranks, console)


def _evaluate(command: EvalCommand, device: str, ranks: Ranks, console: Console) -> None:
    from pcore.cli.diagnosing import note
    from pcore.cli.output import results_folder
    from pcore.cli.results import counting
    from pcore.data.scene import check_images
    from pcore.evaluation.mended import mended_notes
    from pcore.evaluation.methods import baseline_of, methods_of, open_subject
    from pcore.evaluation.protocol import PROTOCOLS, load_perceptual
    from pcore.evaluation.runner import evaluate
    from pcore.evaluation.states import open_states
    from pcore.files.provenance import made_by

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
        results_folder(output, about=run.path)
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
    from pcore.files.run_record import relative

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
    from pcore.asset.posing import script_of
    from pcore.errors import InputError
    from pcore.evaluation.edited import EditedShape
    from pcore.evaluation.states import CANONICAL

    names = [file.stem for file in command.edit]
    if len({*names}) < len(names):
        raise InputError(
            f"--edit: expected files of different names, got {', '.join(map(str, command.edit))}"
        )
    if command.against is not None and not names:
        raise InputError("--against: expected --edit FILE, which is to be scored, got none")
    subjects = [(one.points, one.rig) for one in runs]
    states: list[State] = []
    odd: list[str] = []
    for name, file in zip(names, command.edit, strict=True):
        shape = EditedShape(script_of(file, command.time), subjects)
        if command.against is None:
            shots = places.select([CANONICAL])[0].shots
            states.append(shape.state(name, shots, places.scene.center))
        else:
            shots, size = places.true_shots(command.against), places.size_in(command.against)
            states.append(shape.against(name, shots, size))
        odd += [f"{file}: {line}" for line in shape.notes]
    return states, odd


def finish(
    console: Console,
    output: Path,
    rows: Sequence[ImageRow],
    *,
    about: Mapping[str, Any],
    perceptual: Perceptual,
    notes: Sequence[str] = (),
) -> None:
    """Write rows and summary into `output` and print the table; the first method is the baseline.

    Raises:
        OSError: a file cannot be written.
    """
    from pcore.cli.results import show_results
    from pcore.evaluation.summary import gains, state_means
    from pcore.evaluation.tables import summary_record, write_tables

    means = state_means(rows)
    found = gains(means, means[0].method)
    record = summary_record(means, found, about=about, perceptual=perceptual, notes=notes)
    write_tables(output, rows, record)
    show_results(console, means, found, perceptual=perceptual, notes=notes)
    console.print(Text(f"written to {output}"), soft_wrap=True)


def _sheet_writer(folder: Path, methods: Sequence[Method]) -> Callable[[Taken], None]:
    from pcore.evaluation.figures import png_bytes
    from pcore.evaluation.panels import comparison_sheet
    from pcore.files.atomic import write_atomically

    folder.mkdir(parents=True, exist_ok=True)
    names = [method.name for method in methods]

    def write(taken: Taken) -> None:
        file = f"{taken.state}-{taken.view}.png".replace(":", "_")
        write_atomically(folder / file, png_bytes(comparison_sheet(taken, names)))

    return write
