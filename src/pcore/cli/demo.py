"""`pcore demo`: the whole story on the embedded sample, ending with a report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.console import Console
from rich.text import Text
from tyro.conf import arg

from pcore.cli.options import Count
from pcore.cli.runtime import DeviceName

if TYPE_CHECKING:
    from pcore.cli.demo_folder import DemoFolder
    from pcore.cli.sessions import Session
    from pcore.files.provenance import Stage
    from pcore.training.config import FinetuneConfig, PretrainConfig

STAGES = ("sample", "pre-training", "fine-tuning", "evaluation", "videos", "report")


@dataclass(frozen=True, kw_only=True)
class DemoCommand:
    """Make the sample, pre-train PAPR, fine-tune it with P-CORE, compare both, write a report.

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
        from pcore.cli.runtime import pick_device, prepare_torch

        prepare_torch(self.threads)
        make_demo(self.output, default_settings(), Console(), device=pick_device(self.device))


@dataclass(frozen=True, kw_only=True)
class DemoSettings:
    """How large a demo is."""

    pretrain: PretrainConfig
    finetune: FinetuneConfig
    resolution: int = 100
    """Pixels along each side of the sample's images."""
    train_views: int = 60
    test_views: int = 10
    frames: int = 48
    """Pictures of each video."""
    shown: tuple[int, ...] = field(default=(2, 6))
    """Numbers of the test views in the report."""


def default_settings() -> DemoSettings:
    """Settings of `pcore demo`."""
    from pcore.training.presets import demo_finetune, demo_pretrain

    return DemoSettings(pretrain=demo_pretrain(), finetune=demo_finetune())


def make_demo(path: Path, settings: DemoSettings, console: Console, *, device: str) -> Path:
    """Run all stages that are not done yet and return the report.

    Raises:
        DependencyError: an extra is missing; said before any work.
        InputError: the folder holds something else.
        TrainingError: a training diverged or cannot write.
        KeyboardInterrupt: Ctrl-C; what is done is kept.
    """
    from pcore.cli.demo_folder import DemoFolder
    from pcore.cli.demo_story import evaluate_demo, film_demo, models_of
    from pcore.data.video import require_video
    from pcore.evaluation.report import require_jinja
    from pcore.sample.sample_render import ray_caster_class

    for check in (require_jinja, require_video, ray_caster_class):
        check()
    folder = DemoFolder.open(path)
    _say(console, 1, "a small textured object and true pictures of its deformed states")
    _sample(folder, settings, console)
    _say(console, 2, f"PAPR learns the object from {settings.train_views} pictures")
    _pretrain(folder, settings, console, device)
    _say(console, 3, "P-CORE learns to keep the surface closed; no deformed picture is used")
    _finetune(folder, settings, console, device)
    models = models_of(folder, device)
    _say(console, 4, "both on test views, canonical and deformed")
    evaluate_demo(folder, settings, models, console)
    _say(console, 5, "once around the object")
    film_demo(folder, settings, models, console)
    return _report(folder, settings, console)


def _say(console: Console, number: int, what: str) -> None:
    line = Text.assemble((f"{number}/{len(STAGES)} {STAGES[number - 1]}", "bold"), f": {what}")
    console.print(line, soft_wrap=True)


def _sample(folder: DemoFolder, settings: DemoSettings, console: Console) -> None:
    from pcore.cli.demo_folder import stamp_of
    from pcore.cli.results import counting
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


def _pretrain(folder: DemoFolder, settings: DemoSettings, console: Console, device: str) -> None:
    from pcore.cli.demo_folder import stamp_of
    from pcore.cli.sessions import disk_space, run_session
    from pcore.data.load import load_scene
    from pcore.files.records import to_dict
    from pcore.training.pretrain import pretrain

    wanted = settings.pretrain
    config = {"preset": "tiny", "factor": 1, "pretrain": to_dict(wanted)}
    stamp, path = stamp_of(config), folder.path / "papr"
    if folder.done("pre-training", stamp) and path.is_dir():
        return
    scene = load_scene(folder.path / "sample")
    session = _session(folder, path, "pretrain", config, disk_space(wanted.model, wanted.points))
    with folder.timed("pre-training", stamp):
        run_session(
            session,
            lambda run, tell: pretrain(scene, wanted, folder=run, listener=tell, device=device),
            console,
        )


def _finetune(folder: DemoFolder, settings: DemoSettings, console: Console, device: str) -> None:
    from pcore.cli.demo_folder import stamp_of
    from pcore.cli.sessions import disk_space, run_session
    from pcore.data.load import load_scene
    from pcore.files.model_file import MODEL_FILE, load_model
    from pcore.files.records import to_dict
    from pcore.training.finetune import finetune
    from pcore.training.trained import Trained

    wanted, path = settings.finetune, folder.path / "pcore"
    config = {"base": "../papr", "preset": "tiny", "factor": 1, "finetune": to_dict(wanted)}
    stamp = stamp_of(config, folder.path / "papr" / MODEL_FILE)
    if folder.done("fine-tuning", stamp) and path.is_dir():
        return
    saved = load_model(folder.path / "papr")
    base = Trained(papr=saved.papr(), cloud=saved.cloud, step=saved.provenance.step)
    scene = load_scene(folder.path / "sample")
    needed = disk_space(saved.config, len(saved.cloud))
    with folder.timed("fine-tuning", stamp):
        run_session(
            _session(folder, path, "finetune", config, needed),
            lambda run, tell: finetune(
                scene, base, wanted, folder=run, listener=tell, device=device
            ),
            console,
        )


def _session(
    folder: DemoFolder, path: Path, stage: Stage, config: Mapping[str, Any], needed: int
) -> Session:
    from pcore.cli.sessions import Session
    from pcore.cli.stages import begun

    return Session(
        path=path,
        stage=stage,
        scene=folder.path / "sample",
        config=config,
        resume=begun(path),
        tensorboard=False,
        needed=needed,
    )


def _report(folder: DemoFolder, settings: DemoSettings, console: Console) -> Path:
    """Write the page; made anew every time, from the files of the other stages."""
    from pcore.cli.demo_report import build_report, summary_lines
    from pcore.evaluation.report import render_report
    from pcore.files.atomic import write_atomically

    target = folder.path / "report.html"
    write_atomically(target, render_report(build_report(folder, settings)).encode())
    for line in summary_lines(folder):
        console.print(Text(line), soft_wrap=True)
    console.print(Text.assemble("Report: ", (str(target.resolve()), "bold")), soft_wrap=True)
    return target
