"""`pcore compare RUN...`: rules of other methods, our own, and pictures of any code."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.options import Count, Folder, Output
from pcore.cli.runtime import DeviceName
from pcore.cli.torchrun import is_first


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
        from pcore.cli.compare_results import compare

        compare(self, Console(quiet=not is_first()))
