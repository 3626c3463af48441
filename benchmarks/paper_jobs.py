"""What the tables of the paper need: which runs of which scenes, and what scores them."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.paper_figures import TABLES
from benchmarks.paper_scenes import AT_HAND, Found, Skipped, find, states_of
from pcore.errors import PcoreError
from pcore.evaluation.contestants import METHODS
from pcore.files.run_record import begun, finished

_AT_REST = ("papr", "3dgs-fixed", "2dgs-affine")
"""Methods that differ before any editing; those of them that `pcore compare` knows."""
MODELS = ("papr", "pcore", "gaussians")
"""What is trained of a scene: the first is fine-tuned to the second."""
SKINNED = ("knight", "robot")


@dataclass(frozen=True, kw_only=True)
class Step:
    """A command and whether its result is there already."""

    words: tuple[str, ...]
    done: bool = False


@dataclass(frozen=True, kw_only=True)
class Job:
    """What is done with one scene, in this order; the last step scores it."""

    scene: Found
    steps: tuple[Step, ...]
    folder: Path


@dataclass(kw_only=True)
class Wish:
    """What is asked for."""

    table: str
    data: Path
    runs: Path
    only: Sequence[str]
    factor: int | None
    preset: str
    models: Sequence[str]
    training: Sequence[str]
    options: Sequence[str]
    skipped: list[Skipped] = field(default_factory=list)

    @property
    def out(self) -> Path:
        """Folder of the tables."""
        return self.runs / "paper"


def plan(wish: Wish) -> list[Job]:
    """Jobs of a table; what is left out is added to the wish, with the reason."""
    sets = TABLES[wish.table].sets if wish.table in TABLES else _sets_of(wish.table)
    only = wish.only or (("lego",) if wish.table == "ablation" else ())
    scenes, skipped = find(wish.data, sets, wish.factor, only)
    wish.skipped += skipped
    jobs: list[Job] = []
    for scene in scenes:
        try:
            jobs += _job(wish, scene)
        except PcoreError as error:
            wish.skipped.append(Skipped(name=scene.run, reason=str(error)))
    return jobs


def _sets_of(table: str) -> tuple[str, ...]:
    return {"ablation": ("NeRF-Synthetic", AT_HAND), "nbs": (AT_HAND,)}[table]


def _job(wish: Wish, scene: Found) -> list[Job]:
    run = wish.runs / scene.run
    if wish.table == "nbs" and scene.name not in SKINNED:
        return []
    models = {"ablation": MODELS[:1], "nbs": MODELS[:2]}.get(wish.table, wish.models)
    trained = [_training(wish, scene, run, model) for model in MODELS if model in models]
    if wish.table == "nbs":
        return [Job(scene=scene, steps=tuple(trained), folder=run)]
    if wish.table == "ablation":
        score = Step(words=("ablate", str(run), *wish.options))
        return [Job(scene=scene, steps=(*trained, score), folder=run / "ablation")]
    states, methods = _scored(wish, scene)
    runs = [str(_folder(run, model)) for model in MODELS if model in models]
    words = ("compare", *runs, "--state", *states, *methods, "-o", str(run / "compare"))
    score = Step(words=(*words, *wish.options))
    return [Job(scene=scene, steps=(*trained, score), folder=run / "compare")]


def _scored(wish: Wish, scene: Found) -> tuple[list[str], list[str]]:
    """States and methods of a comparison."""
    if wish.table == "nvs":
        return ["canonical"], ["--methods", *(name for name in _AT_REST if name in METHODS)]
    table, trained = TABLES[wish.table], wish.table == "motion"
    states = states_of(scene, table.kinds, trained=trained)
    if not states:
        what = " with training photos" if trained else ""
        raise PcoreError(f"no state{what} that the table is about and whose motion is known")
    methods = {"motion": ["--methods", "papr", "motion"]}.get(wish.table, [])
    return states, methods


def _training(wish: Wish, scene: Found, run: Path, model: str) -> Step:
    path = _folder(run, model)
    if model == "pcore":
        words = ["finetune", str(run), "-o", str(path)]
    else:
        words = ["train", str(scene.path), "-o", str(path), "--model", model]
        words += ["--factor", str(scene.factor)]
    more = ["--resume"] if begun(path) else []
    words += ["--preset", wish.preset, *wish.training, *more]
    return Step(words=tuple(words), done=finished(path))


def _folder(run: Path, model: str) -> Path:
    return run if model == "papr" else run.with_name(f"{run.name}-{model}")


def show(jobs: Sequence[Job], skipped: Sequence[Skipped]) -> None:
    """Print what would be done."""
    for job in jobs:
        size = f"{job.scene.size[0]} x {job.scene.size[1]}"
        print(f"{job.scene.data.name}, {job.scene.name} ({size}):")
        for step in job.steps:
            state = "done " if step.done else "to do"
            print(f"  {state}  pcore {shlex.join(step.words)}")
    for one in skipped:
        print(f"left out: {one.name}: {one.reason}")
