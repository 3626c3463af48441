"""`pcore demo`: the whole story on the embedded sample, ending with a report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from rich.console import Console
from rich.text import Text
from tyro.conf import arg

from pcore.cli.console import counting, say
from pcore.cli.options import Count
from pcore.cli.runtime import DeviceName, pick_device, prepare_torch
from pcore.files.atomic import write_atomically

if TYPE_CHECKING:
    from pcore.asset.training import RunOptions
    from pcore.demo.demo_folder import DemoFolder
    from pcore.demo.demo_settings import DemoSettings
    from pcore.training.config import PretrainConfig
    from pcore.training.gaussian_config import GaussianConfig

STAGES = (
    *("sample", "Gaussians", "pre-training", "fine-tuning"),
    *("evaluation", "videos", "report"),
)


@dataclass(frozen=True, kw_only=True)
class DemoCommand:
    """Make the sample, learn it as Gaussians and by the paper's method, compare, write a report.

    Takes minutes on two cores and needs no download. The same command in the same folder goes on
    where an interrupted one stopped.
    """

    output: Annotated[Path, arg(aliases=["-o"], metavar="FOLDER")] = Path("pcore-demo")
    """Folder for everything; new, empty, or that of an earlier demo."""

    device: DeviceName = "auto"
    """Where to compute; auto takes a GPU where there is one."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Do it; raises PcoreError subclasses for what the user can mend."""
        from pcore.demo import demo_settings

        prepare_torch(self.threads)
        make_demo(
            self.output,
            demo_settings.default_settings(),
            Console(),
            device=pick_device(self.device),
        )


def make_demo(path: Path, settings: DemoSettings, console: Console, *, device: str) -> Path:
    """Run all stages that are not done yet and return the report."""
    from pcore.data.video import require_video
    from pcore.demo.demo_folder import DemoFolder
    from pcore.demo.demo_story import evaluate_demo, film_demo, models_of
    from pcore.evaluation.report import require_jinja
    from pcore.sample.sample_render import ray_caster_class

    for check in (require_jinja, require_video, ray_caster_class):
        check()
    folder = DemoFolder.open(path)
    _say(console, 1, "a small textured object and true pictures of its deformed states")
    _sample(folder, settings, console)
    _say(console, 2, f"3D Gaussians learn the object from {settings.train_views} pictures")
    _train(folder, "Gaussians", settings.gaussians, console, device)
    _say(console, 3, "PAPR learns it from the same pictures")
    _train(folder, "pre-training", settings.pretrain, console, device)
    _say(console, 4, "P-CORE learns to keep the surface closed; no deformed picture is used")
    _finetune(folder, settings, console, device)
    models = models_of(folder, device)
    _say(console, 5, "all on test views, canonical and deformed")
    with counting(console, "pictures") as tell:
        evaluate_demo(folder, settings, models, tell)
    _say(console, 6, "once around the object")
    with counting(console, "frames") as tell:
        film_demo(folder, settings, models, tell)
    return _report(folder, settings, console)


def _say(console: Console, number: int, what: str) -> None:
    line = Text.assemble((f"{number}/{len(STAGES)} {STAGES[number - 1]}", "bold"), f": {what}")
    say(console, line)


def _sample(folder: DemoFolder, settings: DemoSettings, console: Console) -> None:
    from pcore.demo.demo_folder import stamp_of
    from pcore.sample.sample import make_sample

    size = {
        "resolution": settings.resolution,
        "train_views": settings.train_views,
        "test_views": settings.test_views,
    }
    stamp = stamp_of(size)
    if folder.done("sample", stamp):
        return
    with folder.timed("sample", stamp), counting(console, "pictures") as tell:
        make_sample(folder.path / "sample", **size, progress=tell)


def _train(
    folder: DemoFolder,
    stage: Literal["Gaussians", "pre-training"],
    config: GaussianConfig | PretrainConfig,
    console: Console,
    device: str,
) -> None:
    from pcore.asset.training import train
    from pcore.capture.load import load_scene
    from pcore.cli.sessions import shown_training
    from pcore.demo.demo_folder import stamp_of
    from pcore.demo.demo_story import BASELINE, CARRIED, RUNS
    from pcore.files.records import to_dict

    path = folder.path / RUNS[CARRIED if stage == "Gaussians" else BASELINE]
    stamp = stamp_of(to_dict(config))
    if folder.done(stage, stamp) and path.is_dir():
        return
    scene = load_scene(folder.path / "sample")
    with folder.timed(stage, stamp), shown_training(console) as (listener, note):
        train(
            scene,
            config,
            folder=path,
            listener=listener,
            device=device,
            options=_options(path, note),
        )


def _finetune(folder: DemoFolder, settings: DemoSettings, console: Console, device: str) -> None:
    from pcore.asset.saving import load
    from pcore.asset.training import finetune
    from pcore.capture.load import load_scene
    from pcore.cli.sessions import shown_training
    from pcore.demo.demo_folder import stamp_of
    from pcore.files.model_file import MODEL_FILE
    from pcore.files.records import to_dict

    base, path = folder.path / "papr", folder.path / "pcore"
    stamp = stamp_of(to_dict(settings.finetune), base / MODEL_FILE)
    if folder.done("fine-tuning", stamp) and path.is_dir():
        return
    scene = load_scene(folder.path / "sample")
    with folder.timed("fine-tuning", stamp), shown_training(console) as (listener, note):
        finetune(
            load(base),
            scene,
            settings.finetune,
            folder=path,
            listener=listener,
            device=device,
            options=_options(path, note),
        )


def _options(path: Path, note: Callable[[str], None]) -> RunOptions:
    from pcore.asset.training import RunOptions
    from pcore.files.run_record import begun

    # The story is that of the paper, whose pictures have their light baked in.
    return RunOptions(light=False, resume=begun(path), preset="tiny", note=note)


def _report(folder: DemoFolder, settings: DemoSettings, console: Console) -> Path:
    """Write the page; made anew every time, from the files of the other stages."""
    from pcore.demo.demo_report import build_report, summary_lines
    from pcore.evaluation.report import render_report

    target = folder.path / "report.html"
    write_atomically(target, render_report(build_report(folder, settings)).encode())
    for line in summary_lines(folder):
        say(console, line)
    say(console, Text.assemble("Report: ", (str(target.resolve()), "bold")))
    return target
