"""`pcore compare RUN...`: rules of other methods, our own, and pictures of any code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from rich.console import Console
from rich.text import Text
from tyro.conf import Positional, arg

from pcore.cli.options import Count, Folder, Output, named_paths
from pcore.cli.runtime import DeviceName
from pcore.cli.torchrun import is_first
from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.evaluation.contest import Entry
    from pcore.evaluation.contestants import Given
    from pcore.evaluation.states import SceneStates, State
    from pcore.training.ranks import Ranks


@dataclass(frozen=True, kw_only=True)
class CompareCommand:
    """Compare methods on one object: same field, same photos, same evaluation.

    Give the runs that you have: rivals are trained on their scene (`--methods papr aware` trains
    none), every state is drawn with every method, and tables are written. The same command goes on
    where an interrupted one stopped; a method that fails is a row that says why.
    """

    runs: Annotated[Positional[tuple[Path, ...]], arg(metavar="RUN", help_behavior_hint="")] = ()
    """Folders of trained runs of one scene: PAPR, P-CORE, Gaussians. The first says which scene,
    which size of images, and where results go."""

    scene: Folder = None
    """Folder of the scene; default: the one that the first run was trained on."""

    methods: Annotated[tuple[str, ...], arg(metavar="NAME [NAME ...]")] = ("all",)
    """What to compare; all, none (with --pictures), or some of these. Given runs of points: papr
    (plain rays), aware (rays that know of the deformation), light (the light stands still too).
    Rules on Gaussians, given ones and ones that are trained now: 3dgs-fixed, 3dgs-rotation,
    3dgs-affine, 3dgs-light, sc-gs; on flat ones 2dgs-affine, 2dgs-light. Trained now: mani-gs
    (Gaussians on a mesh), voxels (a field in a cage), papr-time (PAPR for equal time, drawn in the
    three ways of given runs), motion (PAPR in Motion, for states that have training photos)."""

    settings: Annotated[
        tuple[Literal["primitives", "time"], ...], arg(metavar="NAME [NAME ...]")
    ] = ("primitives", "time")
    """How rivals are trained, one row for each: primitives, with as many as the first given run of
    points has (6,000 without one); time, for as long as --seconds says."""

    seconds: Annotated[float, arg(metavar="S")] = 120.0
    """Processor seconds of every training with equal time."""

    seeds: Annotated[tuple[int, ...], arg(metavar="N [N ...]")] = (0,)
    """Seeds of the trainings; from two on the tables show the spread. Runs that differ in their
    seed alone are one row, too."""

    motion_steps: Annotated[int, arg(metavar="N")] = 1000
    """Steps of each of PAPR-in-Motion's two stages, for every state."""

    state: Annotated[tuple[str, ...], arg(metavar="NAME [NAME ...]")] = ("all",)
    """States besides the canonical one: names, `all`, or `scale:S`."""

    every: Annotated[int, arg(metavar="N")] = 1
    """Score every N-th test view only: faster, and enough for a first look."""

    pictures: Annotated[
        tuple[str, ...], arg(metavar="NAME=DIR [NAME=DIR ...]", help_behavior_hint="")
    ] = ()
    """Pictures of other code, each DIR/STATE/VIEW.png; NAME stands in the tables and is no other
    method's."""

    export_field: Folder = None
    """Only write the field, in the forms that official codes take, into this folder."""

    points: Annotated[
        tuple[str, ...], arg(metavar="NAME=FILE [NAME=FILE ...]", help_behavior_hint="")
    ] = ()
    """With --export-field: points of other checkpoints, nodes, meshes or cages (.ply, .npy), to be
    moved in their order; default: those of the runs."""

    output: Output = None
    """Folder for the results; default: compare in the first run."""

    factor: Count = None
    """Down-scaling of the images; default: that of the first run's training."""

    device: DeviceName = "auto"
    """Where to compute; auto takes a GPU where there is one."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Compare; raises PcoreError subclasses for what the user can mend."""
        compare(self, Console(quiet=not is_first()))


def compare(command: CompareCommand, console: Console) -> None:
    """Train, move, draw, score, write and print; processes of torchrun take methods in turn.

    Raises:
        CheckpointError: a run cannot be read.
        SceneError: the scene or a state cannot be read.
        InputError: unknown names, options that do not fit, an output folder in use, or, after all
            is written, no method that could be scored in any state.
    """
    from pcore.cli.runtime import pick_device, prepare_torch
    from pcore.cli.torchrun import joined_ranks, refuse_ranks

    prepare_torch(command.threads)
    device = pick_device(command.device)
    runs = _runs(command, device)
    places, states = _places(command, runs)
    if command.export_field is not None:
        from pcore.cli.export_field import export_field

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
    from pcore.cli.compare_results import finish, teller
    from pcore.cli.results import missing_lpips
    from pcore.evaluation.contest import Contest
    from pcore.evaluation.protocol import load_perceptual
    from pcore.files.provenance import made_by

    places, states = where
    output = ranks.from_first(_output(command, runs, places) if ranks.rank == 0 else Path())
    entries = _entries(command, console, output, runs, where, device)
    asked = [(one.name, one.setting, one.seed, one.stamp) for one in entries]
    ranks.agree({"methods": asked, "states": [(one.name, len(one.shots)) for one in states]})
    perceptual = load_perceptual()
    stamp = [str(places.path.resolve()), places.factor, command.every]
    contest = Contest(folder=output, states=states, stamp=stamp, perceptual=perceptual)
    outcomes = contest.run(entries, teller(console, len(entries) * len(states)))
    if ranks.rank > 0:
        return
    about = {**_about(command, places, states, output), "made_by": made_by(device)}
    names = [state.name for state in states]
    notes = [*([places.left_out] if places.left_out else []), *missing_lpips(perceptual)]
    finish(console, output, outcomes, names, about=about, notes=notes)


def _runs(command: CompareCommand, device: str) -> list[Given]:
    from pcore.evaluation.contestants import Given, stamp_of_run
    from pcore.evaluation.methods import open_subject

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
    """The scene and its states, with the test views that are wanted.

    Raises:
        InputError: neither a run nor a scene; runs of another scene; a bad --every.
    """
    from pcore.data.scene import check_images
    from pcore.evaluation.states import open_states
    from pcore.validation import check_count

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
    """The folder for results: new, empty, or of an earlier comparison on this scene.

    Raises:
        InputError: it holds something else.
        OSError: it cannot be made.
    """
    from pcore.cli.output import results_of
    from pcore.evaluation.contest_tables import COMPARE_FILE

    if command.output is None and not runs:
        raise InputError("compare: expected a folder for the results with -o, as no RUN is given")
    output = command.output or runs[0].asset.path / "compare"
    results_of(output, COMPARE_FILE, about=places.path)
    return output


def _entries(
    command: CompareCommand,
    console: Console,
    output: Path,
    runs: Sequence[Given],
    where: tuple[SceneStates, Sequence[State]],
    device: str,
) -> list[Entry]:
    from pcore.asset.neural_points import NeuralPoints
    from pcore.evaluation.contestants import given_entries, needed
    from pcore.evaluation.motion_method import has_end_views, motion_entries
    from pcore.evaluation.picture_entries import picture_entries
    from pcore.evaluation.rival_entries import Workshop
    from pcore.rivals.motion_stages import MotionConfig
    from pcore.training.presets import gaussian_preset, preset

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
        note=lambda text: console.print(Text(f"training: {text}"), soft_wrap=True),
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
    from pcore.evaluation.contestants import METHODS

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
    from pcore.files.run_record import relative

    return {
        "run": relative(places.path, output),
        "kinds": {state.name: state.kind for state in states},
        "factor": places.factor,
        "every": command.every,
        "seconds": command.seconds,
        "seeds": [*command.seeds],
        "runs": [relative(path, output) for path in command.runs],
    }
