"""`pcore eval RUN`: score a run on the true images of its scene, canonical and deformed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from rich.console import Console
from rich.text import Text
from tyro.conf import Positional, arg

from pcore.cli.light import LightChoice, LightName
from pcore.cli.options import Count, Folder, Number, Output, Samples, check_given_samples
from pcore.cli.runtime import DeviceName

if TYPE_CHECKING:
    from pcore.cli.models import Run
    from pcore.data.scene import Scene
    from pcore.evaluation.protocol import Perceptual
    from pcore.evaluation.runner import ImageRow, Method, Taken
    from pcore.evaluation.states import SceneStates, State

PICTURES = "pictures"
_LISTED = 20


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
        evaluate_run(self, Console())


def evaluate_run(command: EvalCommand, console: Console) -> None:
    """Score the run, write the files and print the table.

    Raises:
        CheckpointError: the run or its baseline cannot be read.
        SceneError: the scene or a state cannot be read or scored.
        EditError: an edit file is not valid or does not fit the points.
        InputError: an unknown state, a factor that does not fit, or an output folder in use.
    """
    from pcore.cli.models import baseline_of, open_run
    from pcore.cli.output import results_folder
    from pcore.cli.results import counting
    from pcore.cli.runtime import pick_device, prepare_torch, scene_of
    from pcore.cli.stages import relative
    from pcore.data.scene import check_images
    from pcore.evaluation.protocol import PROTOCOLS, load_perceptual
    from pcore.evaluation.runner import evaluate
    from pcore.evaluation.states import open_states
    from pcore.render.picture import render

    check_given_samples(command.samples)
    prepare_torch(command.threads)
    device = pick_device(command.device)
    run = open_run(command.run_folder, device=device)
    base = baseline_of(run, command.baseline, device=device)
    runs = [run] if base is None else [base, run]
    factor = run.factor if command.factor is None else command.factor
    places = open_states(scene_of(run.manifest, command.scene), factor=factor)
    states = places.select(command.state or (() if command.edit else ("all",)))
    edited, odd = _edited(command, places, runs)
    states += edited
    check_images(shot.view for state in states for shot in state.shots)
    output = command.output or command.run_folder / "eval"
    results_folder(output, about=run.path)
    methods = _methods(run, base, command.rays, command.light, places.scene)
    chosen = PROTOCOLS.values() if command.protocol == "both" else [PROTOCOLS[command.protocol]]
    perceptual = load_perceptual()
    with counting(console, "pictures") as tell:
        rows = evaluate(
            methods,
            states,
            draw=partial(render, samples=command.samples),
            protocols=list(chosen),
            perceptual=perceptual,
            progress=tell,
            show=_sheet_writer(output / PICTURES, methods) if command.pictures else None,
        )
    about = {
        "run": relative(run.path, output),
        "baseline": None if base is None else relative(base.path, output),
        "scene": relative(places.path, output),
        "factor": places.factor,
        "samples": {one.path.name: command.samples or one.papr.config.samples for one in runs},
    }
    left_out = [places.left_out] if places.left_out else []
    counts = {one.papr.config.samples for one in runs}
    if command.samples is None and len(counts) > 1:
        odd.append("the runs send another number of rays per pixel each; give --samples for one")
    notes = [*left_out, *odd, *_mended(rows, methods, states)]
    finish(console, output, rows, about=about, perceptual=perceptual, notes=notes)


def _edited(
    command: EvalCommand, places: SceneStates, runs: Sequence[Run]
) -> tuple[list[State], list[str]]:
    """States of the edit files, and what is odd about them."""
    from pcore.cli.diagnosing import script_at
    from pcore.editing.runs import learned_rig
    from pcore.errors import InputError
    from pcore.evaluation.edited import EditedShape
    from pcore.evaluation.states import CANONICAL

    names = [file.stem for file in command.edit]
    if len({*names}) < len(names):
        raise InputError(
            f"--edit: expected files of different names, got {', '.join(map(str, command.edit))}"
        )
    clouds = [one.cloud.positions.detach().cpu() for one in runs]
    subjects = [(c, learned_rig(one.path, c)) for c, one in zip(clouds, runs, strict=True)]
    shots = places.select([CANONICAL])[0].shots
    states: list[State] = []
    odd: list[str] = []
    for name, file in zip(names, command.edit, strict=True):
        shape = EditedShape(script_at(file, command.time), subjects)
        states.append(shape.state(name, shots, places.scene.center))
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


def _mended(
    rows: Sequence[ImageRow], methods: Sequence[Method], states: Sequence[State]
) -> list[str]:
    """Say at which points estimated frames had to be replaced, once per state and cloud."""
    from pcore.evaluation.runner import carry

    named = {method.name: method for method in methods}
    places = {state.name: state for state in states}
    found: dict[tuple[str, int], dict[str, None]] = {}
    for row in rows:
        if row.scores["mended_frames"]:
            # Methods of one run share their frames.
            found.setdefault((row.state, id(named[row.method].cloud)), {})[row.method] = None
    notes: list[str] = []
    for (state, _), names in found.items():
        # Moved once more: the rows hold numbers only, and few states come here.
        one = named[next(iter(names))]
        frames = carry([one], places[state])[one.name].frames
        numbers = [] if frames is None else frames.mended.tolist()
        notes.append(
            f"state {state}, {', '.join(names)}: {len(numbers)} of {len(one.cloud):,} local frames "
            "were estimated inside out and replaced by a similarity, at points number "
            f"{', '.join(map(str, numbers[:_LISTED]))}{', ...' * (len(numbers) > _LISTED)}"
        )
    return notes


def _methods(
    run: Run, base: Run | None, rays: str, light: LightName | None, scene: Scene
) -> list[Method]:
    """Baseline first; two methods of one name are told apart by the folders of their runs.

    Where a run has a light, aware rays come with it as well, unless the light is to be baked.
    """
    from pcore.cli.light import shading_of
    from pcore.cli.models import never_seen
    from pcore.evaluation.runner import Method

    runs = [run] if base is None else [base, run]
    alike = base is not None and base.label == run.label
    found: list[Method] = []
    for one in runs:
        unseen = never_seen(one.cloud, scene)
        wanted = rays != "plain"
        shading = shading_of(one.path, one.cloud, light, aware=True) if wanted else None
        ways = [(False, None), (True, None), (True, shading)][: 2 if shading is None else 3]
        found += [
            Method(
                name=_name(one, aware=aware, lit=lamp is not None)
                + (f" ({one.path.resolve().name})" if alike else ""),
                papr=one.papr,
                cloud=one.cloud,
                aware=aware,
                unseen=unseen,
                shading=lamp,
            )
            for aware, lamp in ways
            if rays in ("both", "aware" if aware else "plain")
        ]
    # Plain rays of all runs, then aware ones, then those with a light: of the baseline first.
    return sorted(found, key=lambda method: (method.aware, method.shading is not None))


def _name(run: Run, *, aware: bool, lit: bool) -> str:
    if not aware:
        return run.label
    from pcore.cli.models import UNTUNED

    name = "aware" if run.label == UNTUNED else f"aware + {run.label}"
    return f"{name} + light" if lit else name


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
