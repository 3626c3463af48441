"""`pcore export`: write the Gaussians of a run, at rest or edited, for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from rich.console import Console
from rich.text import Text
from tyro.conf import Positional, arg

from pcore.cli.options import Count, Number, optional
from pcore.errors import InputError


@dataclass(frozen=True, kw_only=True)
class ExportCommand:
    """Write a run as Gaussians that viewers, trainers and browsers read; at rest or edited."""

    run_folder: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of a run of Gaussians."""

    to: Literal["splats"] = "splats"
    """What to write: 3D Gaussians."""

    output: Annotated[Path, arg(aliases=["-o"], metavar="OUT")]
    """Where to: .ply as INRIA's trainer writes it, .splat (one colour each), .glb (glTF with
    KHR_gaussian_splatting, y up). Replaced if it exists."""

    edit: Annotated[Path | None, optional("FILE")] = None
    """Edit file (JSON) to apply first."""

    time: Number = None
    """For an edit file with keyframes: the time to apply."""

    split: Annotated[float | None, optional("TOLERANCE")] = None
    """Split Gaussians that the edit bends within themselves by more than this share of their
    thickness, such as 0.3; default: split none."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Do it; raises PcoreError subclasses for what the user can mend."""
        export(self, Console())


def export(command: ExportCommand, console: Console) -> None:
    """Write the Gaussians of a run and say what was written.

    Raises:
        CheckpointError: no run there, or it is damaged.
        EditError: the edit file is not valid, or folds space everywhere.
        InputError: a run without Gaussians, or a file that cannot be written.
    """
    from pcore.asset.gaussian_content import GaussianContent
    from pcore.asset.posing import script_of
    from pcore.asset.saving import load
    from pcore.cli.deform_gaussians import edit_notes
    from pcore.cli.runtime import prepare_torch
    from pcore.data.splat_file import splats_of
    from pcore.data.splat_formats import check_splat_output, save_splats
    from pcore.editing.gaussian_edit import edited_gaussians

    check_splat_output(command.output)
    prepare_torch(command.threads)
    saved = load(command.run_folder).content
    if not isinstance(saved, GaussianContent):
        raise InputError(
            f"{command.run_folder}: expected a run of Gaussians, got one of PAPR's points, which "
            "have no Gaussians; train with `pcore train SCENE --model gaussians`"
        )
    file, notes = splats_of(saved.gaussians, str(command.run_folder)), list[str]()
    if command.edit is not None:
        script = script_of(command.edit, command.time)
        edited = edited_gaussians(file, script, split=command.split)
        file, notes = edited.file, [*edit_notes(edited), *edited.bound.notes]
    notes += save_splats(command.output, file)
    if saved.footprint.antialiased:
        notes.append(
            "they were trained antialiased: switch that on in the viewer (SuperSplat) or trainer "
            "(gsplat: rasterize_mode), or they look a little bolder"
        )
    count = len(file.gaussians)
    lines = [f"{command.output}: {count:,} Gaussians of degree {file.gaussians.degree}"]
    for line in [*lines, *(f"  note: {note}" for note in notes)]:
        console.print(Text(line), soft_wrap=True)
