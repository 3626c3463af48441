"""`pcore ablate RUN`: the paper's ablation on one run, with its figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.console import counting, say
from pcore.cli.diagnosing import note
from pcore.cli.losses import check_weights
from pcore.cli.options import Count, Folder, Output, PresetName, optional
from pcore.cli.output import results_folder
from pcore.cli.runtime import DeviceName, pick_device, prepare_torch
from pcore.errors import InputError
from pcore.files.atomic import write_atomically

if TYPE_CHECKING:
    from pcore.asset.asset import Asset
    from pcore.asset.training import FinetuneSettings
    from pcore.evaluation.ablation import AblationFigure, Variant
    from pcore.evaluation.asset_method import AssetMethod
    from pcore.evaluation.states import SceneStates
    from pcore.files.run_record import RunRecord

FIGURE_FILE = "ablation.png"


@dataclass(frozen=True, kw_only=True)
class AblateCommand:
    """Fine-tune a run with parts left out, score every variant, and draw the paper's figure.

    Every variant is a run of its own in the output folder. The same command goes on where an
    interrupted one stopped and does not repeat what is finished.
    """

    run_folder: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of a pre-trained run; it is left as it is."""

    scene: Folder = None
    """Folder of the scene; default: the one the run was trained on."""

    state: Annotated[tuple[str, ...], arg(metavar="NAME [NAME ...]")] = ("scale:2",)
    """States to score on; the figure shows the first. `all` for every state of the scene."""

    output: Output = None
    """Folder for the variants and results; default: RUN/ablation."""

    preset: Annotated[PresetName | None, optional("{tiny,fast,paper}")] = None
    """Settings of every fine-tuning; default: as for `pcore finetune`."""

    steps: Count = None
    """Steps of every fine-tuning; default: those of the preset."""

    view: Annotated[int, arg(metavar="N")] = 0
    """Number of the test view in the figure, from 0."""

    factor: Count = None
    """Down-scaling of the true images; default: that of the training."""

    device: DeviceName = "auto"
    """Where to compute; auto takes a GPU where there is one."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Train, score, write and print; raises PcoreError subclasses."""
        ablate(self, Console())


def ablate(command: AblateCommand, console: Console) -> None:
    """Do it; everything that can be known is checked before the first training."""
    from pcore.asset.saving import load
    from pcore.evaluation.ablation import AblationFigure, variants_for
    from pcore.evaluation.tables import SUMMARY_FILE
    from pcore.training.config import FinetuneConfig

    prepare_torch(command.threads)
    device = pick_device(command.device)
    asset = load(command.run_folder, device=device)
    record = asset.record
    if record.base is not None:
        raise InputError(
            f"{asset.path} is fine-tuned already: expected a pre-trained run, whose variants are "
            f"compared with it; ablate the run that it was tuned from, {record.base}"
        )
    places, first = _places(command, console, record)
    output = command.output or command.run_folder / "ablation"
    full = _full_config(asset, command)
    if isinstance(full, FinetuneConfig):
        check_weights(full.lpips_weight, full.lpips_trunk)
    results_folder(output, SUMMARY_FILE, about=asset.path)
    variants = variants_for(full)
    for variant in variants:
        path, config = output / variant.folder, variant.config(full)
        _train(console, (asset, places), path, config, device)
    methods = _methods(asset, output, places, variants, device)
    figure = AblationFigure(first, command.view)
    _score(command, console, (asset, places), methods, figure)


def _places(command: AblateCommand, console: Console, record: RunRecord) -> tuple[SceneStates, str]:
    """The scene with its states, and the name of the first deformed one."""
    from pcore.data.scene import check_images
    from pcore.evaluation.states import open_states

    factor = record.factor if command.factor is None else command.factor
    masks = record.masks if command.scene is None else None
    places = open_states(record.scene_or(command.scene), factor=factor, masks=masks)
    states = places.select(command.state)
    note(console, places.scene.notes)
    check_images(shot.view for state in states for shot in state.shots)
    if len(states) < 2:
        raise InputError(f"{places.path}: no deformed state to score; give --state scale:2")
    if not 0 <= command.view < len(states[1].shots):
        raise InputError(
            f"--view: expected a number from 0 to {len(states[1].shots) - 1}, the test views of "
            f"{states[1].name}, got {command.view}"
        )
    return places, states[1].name


def _full_config(asset: Asset, command: AblateCommand) -> FinetuneSettings:
    """Settings of the whole method for this run."""
    from pcore.asset.training import finetune_settings

    _, config = finetune_settings(asset, command.preset)
    return config if command.steps is None else replace(config, steps=command.steps)


def _train(
    console: Console,
    source: tuple[Asset, SceneStates],
    path: Path,
    config: FinetuneSettings,
    device: str,
) -> None:
    from pcore.asset.training import RunOptions, finetune
    from pcore.cli.sessions import shown_training
    from pcore.files.run_record import begun

    asset, places = source
    say(console, f"{path.name}: {config.steps:,} steps")
    with shown_training(console) as (listener, note):
        finetune(
            asset,
            places.scene,
            config,
            folder=path,
            listener=listener,
            device=device,
            options=RunOptions(light=False, resume=begun(path), note=note),
        )


def _methods(
    asset: Asset,
    output: Path,
    places: SceneStates,
    variants: Sequence[Variant],
    device: str,
) -> list[AssetMethod]:
    from pcore.asset.saving import load
    from pcore.evaluation.methods import label_of, plain_method

    tuned = [(v.title, load(output / v.folder, device=device)) for v in variants]
    # The paper's question is what its losses do; aware rays would answer for them.
    return [
        plain_method(name, one, places.scene) for name, one in [(label_of(asset), asset), *tuned]
    ]


def _score(
    command: AblateCommand,
    console: Console,
    source: tuple[Asset, SceneStates],
    methods: list[AssetMethod],
    figure: AblationFigure,
) -> None:
    from pcore.cli.eval_results import finish
    from pcore.evaluation.figures import png_bytes
    from pcore.evaluation.protocol import load_perceptual
    from pcore.evaluation.runner import evaluate
    from pcore.files.provenance import made_by
    from pcore.files.run_record import relative

    asset, places = source
    output, perceptual = command.output or command.run_folder / "ablation", load_perceptual()
    with counting(console, "pictures") as tell:
        rows = evaluate(
            methods,
            places.select(command.state),
            perceptual=perceptual,
            progress=tell,
            show=figure,
        )
    about = {
        "run": relative(asset.path, output),
        "scene": relative(places.path, output),
        "factor": places.factor,
        "made_by": made_by(pick_device(command.device)),
    }
    write_atomically(output / FIGURE_FILE, png_bytes(figure.pixels([m.name for m in methods])))
    finish(console, output, rows, about=about, perceptual=perceptual)
    say(console, f"figure: {output / FIGURE_FILE}")
