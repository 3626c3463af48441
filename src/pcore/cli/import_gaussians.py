"""`pcore import gaussians`: make a run of a file of another trainer's Gaussians."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.console import say
from pcore.cli.options import Count, Folder, optional
from pcore.cli.runtime import prepare_torch

if TYPE_CHECKING:
    from pcore.data.splat_file import SplatFile
    from pcore.gaussians.gaussians import Gaussians
    from pcore.gaussians.render import Footprint
    from pcore.training.splat_check import Agreement

_PIXEL = 1 / 12
_FILTERS = ((0.3, False), (0.3, True), (_PIXEL, True))
"""Screen filters of trainers, the usual one first: pixels squared, whether antialiased. The last is
ours, whose comment other programs lose."""
_OF_DISCS = ((0.5, False), (_PIXEL, True))
_FAR = 1e4
"""Single precision has seven digits: so many times its size from the origin an object has three."""


@dataclass(frozen=True, kw_only=True)
class ImportGaussiansCommand:
    """Make a run of the Gaussians of a 3DGS file; it is then used like one of our own."""

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """The .ply of INRIA's trainer, gsplat, nerfstudio, 2DGS or SuperSplat; a .splat, .spz, .sog."""

    output: Annotated[Path, arg(aliases=["-o"], metavar="RUN")]
    """Folder to make; it must be new or empty."""

    scene: Folder = None
    """Folder of the photos it was trained on, which the run remembers: some are compared with what
    the Gaussians show, so that a wrong world is found out."""

    factor: Annotated[int, arg(metavar="N")] = 1
    """Down-scale the photos by this whole number."""

    transform: Annotated[Path | None, optional("FILE")] = None
    """Trainers may move the world: nerfstudio's dataparser_transforms.json, whose map is undone."""

    variance: Annotated[float | None, optional("X")] = None
    """Variance of the screen filter of its trainer, pixels squared; default: what a file of pcore
    says, else that of the usual ones which meets the photos of --scene best, else 0.3, or 0.5
    where the file has two scales (2DGS)."""

    antialiased: bool = False
    """It was trained with opacities that make up for the filter (gsplat's "antialiased")."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Import; raises InputError, SceneError or TrainingError and then leaves no run."""
        import_gaussians(self, Console())


def import_gaussians(command: ImportGaussiansCommand, console: Console) -> None:
    """Read the Gaussians, look at the photos if there are any, write a run."""
    from pcore.asset.importing import save_imported
    from pcore.data.splat_file import filter_words
    from pcore.data.splat_formats import read_splats

    prepare_torch(command.threads)
    file = read_splats(command.file)
    footprints = _footprints(file, command)
    gaussians = _single(_in_world(file.gaussians, command.transform))
    agreement, footprint, doubt = _compared(gaussians, footprints, command)
    save_imported(
        gaussians,
        footprint,
        command.output,
        file=command.file,
        scene=command.scene,
        factor=command.factor,
        background=None if agreement is None else agreement.background,
    )
    lines = [f"{command.output}: {len(gaussians):,} Gaussians of degree {gaussians.degree}"]
    if agreement is not None:
        lines.append(f"  {agreement.views} photos are met by {agreement.psnr:.1f} dB")
    if footprint == file.footprint:
        lines.append(f"  screen filter of the file's own comment: {filter_words(footprint)}")
    elif footprint != footprints[0]:
        usual, found = filter_words(footprints[0]), filter_words(footprint)
        lines.append(f"  screen filter that meets the photos better than {usual}: {found}")
    lines += [f"  note: {line}" for line in [*file.notes, *doubt, *_notes(file, gaussians)]]
    for line in lines:
        say(console, line)


def _footprints(file: SplatFile, command: ImportGaussiansCommand) -> list[Footprint]:
    """Screen filters that the file may have been trained by, the likeliest first."""
    from pcore.gaussians.render import Footprint

    usual = _OF_DISCS if file.flat else _FILTERS
    if command.variance is not None or command.antialiased:
        variance = usual[0][0] if command.variance is None else command.variance
        usual = ((variance, command.antialiased),)
    elif file.footprint is not None:
        return [file.footprint]
    return [Footprint(variance=one, antialiased=two, flat=file.flat) for one, two in usual]


def _in_world(gaussians: Gaussians, transform: Path | None) -> Gaussians:
    """Take the Gaussians back to the world that their trainer moved."""
    from pcore.data.world_transform import load_world_transform
    from pcore.gaussians.carry import deformed

    if transform is None:
        return gaussians
    return deformed(gaussians, load_world_transform(transform).inverse())


def _single(gaussians: Gaussians) -> Gaussians:
    import torch

    return gaussians.to(dtype=torch.float32)


def _compared(
    gaussians: Gaussians, footprints: list[Footprint], command: ImportGaussiansCommand
) -> tuple[Agreement | None, Footprint, list[str]]:
    """How like the photos they are, by which screen filter, and what is doubtful about that."""
    from pcore.capture.load import load_scene
    from pcore.training.splat_check import best_agreement, check_agreement

    if command.scene is None:
        return None, footprints[0], []
    views = load_scene(command.scene, factor=command.factor).split("train")
    found, footprint = best_agreement(gaussians, footprints, views)
    doubt = check_agreement(found, where=str(command.file), scene=str(command.scene))
    return found, footprint, [] if doubt is None else [doubt]


def _notes(file: SplatFile, gaussians: Gaussians) -> list[str]:
    notes: list[str] = []
    if file.flat:
        notes.append("two scales (2DGS): they are drawn as discs")
    lower, upper = gaussians.means.amin(dim=0), gaussians.means.amax(dim=0)
    if float((lower + upper).norm()) / 2 > _FAR * float((upper - lower).norm()):
        notes.append(
            "the object is so far from the origin that single precision, which runs have, blurs "
            "it; move it to the origin first"
        )
    return notes
