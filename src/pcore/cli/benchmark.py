"""`pcore benchmark make`: true pictures and maps of the deformed states of any model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Literal

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.console import counting, say
from pcore.cli.options import optional
from pcore.cli.output import check_place
from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.benchmark.model_states import BenchmarkPlan


@dataclass(frozen=True, kw_only=True)
class BenchmarkMakeCommand:
    """Make a scene with true deformed states of a model, for train, eval and compare."""

    models: Annotated[Positional[tuple[Path, ...]], arg(metavar="MODEL")]
    """.glb or .gltf with textures, skins, morph targets and clips; .obj with its .mtl; .ply with
    colours."""

    output: Annotated[Path, arg(aliases=["-o"], metavar="FOLDER")]
    """Folder to make; with several models, each gets one of its name in it."""

    size: Annotated[int, arg(metavar="N")] = 200
    """Pixels along each side of the pictures."""

    train_views: Annotated[int, arg(metavar="N")] = 100
    """Canonical training views."""

    test_views: Annotated[int, arg(metavar="N")] = 20
    """Test views, canonical and of every state."""

    state_train_views: Annotated[int, arg(metavar="N")] = 0
    """Training views of every state, from which PAPR-in-Motion learns (`pcore compare`)."""

    light: Literal["fixed", "baked"] = "fixed"
    """fixed: light stands still while the object moves; baked: it sticks to the surface."""

    recipe: Annotated[Path | None, optional("FILE")] = None
    """YAML file of models by name, each with its file and options as here, in the place of MODEL;
    see the guide "Benchmarks of your own"."""

    renderer: Literal["embedded", "blender"] = "embedded"
    """embedded: ray casting, on any machine; blender: Cycles, with light between surfaces (the
    extra `blender`, or a Python that has `bpy` in PCORE_BPY)."""

    edits: Annotated[tuple[Path, ...], arg(metavar="FILE")] = ()
    """Edit files, each a state of the file's name; they see an object of radius 1, z up."""

    clips: Annotated[tuple[str, ...], arg(metavar="CLIP[@T]")] = ()
    """Clips of the model that are states, at T seconds or where they differ most from the
    canonical shape; default: all."""

    canonical: Annotated[str | None, optional("CLIP@T")] = None
    """Canonical shape; default: as the file stands."""

    no_analytic: bool = False
    """Leave out twist60, bend60, stretch and scale2x."""

    bend_axis: Annotated[Literal["x", "y", "z"] | None, optional("{x,y,z}")] = None
    """Axis about which bend60 bends; default: z where x is longest, else y."""

    up: Annotated[Literal["y", "z"] | None, optional("{y,z}")] = None
    """Axis that points up in the model; default: y, z for .ply."""

    def run(self) -> None:
        """Do it; raises PcoreError subclasses for what the user can mend."""
        from pcore.benchmark.blender_renderer import blender_python
        from pcore.cli.benchmark_recipe import commands_of
        from pcore.sample.sample_render import ray_caster_class

        ray_caster_class()
        commands = [self] if self.recipe is None else commands_of(self)
        if any(one.renderer == "blender" for one in commands):
            blender_python()
        jobs = [job for one in commands for job in one._jobs(again=self.recipe is not None)]
        console = Console()
        for job in self._checked(jobs, console):
            job.run(console)

    def folders(self, *, again: bool = False) -> list[Path]:
        """Where each model goes; InputError when a place is taken or cannot be made.

        Args:
            again: benchmarks that were made before may be there.
        """
        from pcore.benchmark.making import MANIFEST

        if not self.models:
            raise InputError("benchmark make: expected at least one model or --recipe, got none")
        names = [path.stem for path in self.models]
        if len(set(names)) < len(names):
            raise InputError(
                f"benchmark make: expected models of different names, got {', '.join(names)}"
            )
        one = len(names) == 1
        folders = [self.output if one else self.output / name for name in names]
        check_place(self.output)
        for folder in folders:
            if not (again and (folder / MANIFEST).is_file()):
                _check_free(folder)
        return folders

    def _jobs(self, *, again: bool) -> list[_Job]:
        plan, folders = self._plan(), self.folders(again=again)
        return [
            _Job(path=path, folder=folder, plan=plan, up=self.up)
            for path, folder in zip(self.models, folders, strict=True)
        ]

    @staticmethod
    def _checked(jobs: list[_Job], console: Console) -> list[_Job]:
        """Those that are not made already, each of which can be; a new single one checks itself."""
        from pcore.benchmark.making import MANIFEST, made_already, planned
        from pcore.benchmark.model import read_model

        if len(jobs) == 1 and not (jobs[0].folder / MANIFEST).is_file():
            _check_free(jobs[0].folder)
            return jobs
        left: list[_Job] = []
        for job in jobs:
            model = read_model(job.path, up=job.up)
            if made_already(job.folder, model, job.plan):
                say(console, f"{job.folder}: made already")
                continue
            _check_free(job.folder)
            planned(model, job.plan)
            left.append(job)
        return left

    def _plan(self) -> BenchmarkPlan:
        from pcore.asset.posing import script_of
        from pcore.benchmark.model_states import BenchmarkPlan
        from pcore.validation import check_count

        canonical = None
        if self.canonical is not None:
            name, time = _clip(self.canonical)
            canonical = (name, 0.0 if time is None else time)
        return BenchmarkPlan(
            resolution=check_count("--size", self.size, minimum=8),
            train_views=check_count("--train-views", self.train_views, minimum=2),
            test_views=check_count("--test-views", self.test_views),
            state_train_views=check_count("--state-train-views", self.state_train_views, minimum=0),
            light=self.light,
            renderer=self.renderer,
            analytic=not self.no_analytic,
            bend_axis=self.bend_axis,
            edits=tuple((path.stem, script_of(path)) for path in self.edits),
            clips=tuple(_clip(one) for one in self.clips),
            every_clip=not self.clips,
            canonical=canonical,
        )


@dataclass(frozen=True, kw_only=True)
class _Job:
    """One model, where its benchmark goes, and what that is."""

    path: Path
    folder: Path
    plan: BenchmarkPlan
    up: Literal["y", "z"] | None

    def run(self, console: Console) -> None:
        from pcore.benchmark.making import make_benchmark
        from pcore.benchmark.model import read_model
        from pcore.capture.load import find_states

        model = read_model(self.path, up=self.up)
        with counting(console, "pictures") as tell:
            notes = make_benchmark(self.folder, model, self.plan, progress=tell)
        lines = [f"{self.folder}: {len(model.vertices):,} vertices, {len(model.faces):,} triangles"]
        lines.append(f"  states: {', '.join(find_states(self.folder))}")
        lines += [f"  note: {note}" for note in notes]
        lines.append(f"next: pcore train {quote(str(self.folder))} -o RUN && pcore eval RUN")
        say(console, *lines)


def _check_free(folder: Path) -> None:
    if folder.is_file() or (folder.is_dir() and any(folder.iterdir())):
        raise InputError(
            f"{folder}: expected a new or empty folder, got one with files; use another -o"
        )


def _clip(text: str) -> tuple[str, float | None]:
    """Name and time of `CLIP@T`."""
    name, at, time = text.rpartition("@")
    try:
        return (name, float(time)) if at else (text, None)
    except ValueError:
        return text, None  # Names of clips may have an @ of their own.
