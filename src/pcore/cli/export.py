"""`pcore export`: write a run, at rest or edited, for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.console import say
from pcore.cli.options import Count, Folder, Number, optional
from pcore.cli.runtime import DeviceName, pick_device, prepare_torch
from pcore.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from pcore.asset.asset import Asset

Kind = Literal["ply", "mesh", "glb", "obj", "usd", "splats", "depth", "cameras", "nerfstudio"]


@dataclass(frozen=True, kw_only=True)
class ExportCommand:
    """Write a run, at rest or edited, in its own units for other programs."""

    run_folder: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of a run."""

    to: Kind = "splats"
    """ply: its points with colour, normal and confidence. mesh, or by its format glb, obj, usd: its
    surface. splats: Gaussians. depth: depth and normals of views. cameras: transforms.json and a
    COLMAP model. nerfstudio: pictures of it as a data set."""

    output: Annotated[Path, arg(aliases=["-o"], metavar="OUT")]
    """Where to. Points: .ply. Mesh: .ply, .obj, .glb, .usd, .usda, .usdc. Splats: .ply as INRIA's
    trainer writes it, .splat (one colour each), .glb (KHR_gaussian_splatting, y up). These are
    replaced if they exist. Depth, cameras, nerfstudio: a new or empty folder."""

    edit: Annotated[Path | None, optional("FILE")] = None
    """Edit file (JSON) to apply first."""

    time: Number = None
    """For an edit file with keyframes: the time to apply."""

    frames: Count = None
    """For an edit file with keyframes: so many frames of it, evenly. Meshes in glb (morph targets)
    and usd are one file; other objects get one for each frame, NAME_000, NAME_001, ... Depth: a
    picture for each frame, on a path through the cameras. Cameras: a folder for each frame.
    Nerfstudio: all cameras at each time, as D-NeRF's sets have them (`time`)."""

    scene: Folder = None
    """Folder of the scene whose cameras look at the object; default: the one it was trained on.
    Without either they look from all around."""

    resolution: Count = None
    """Mesh: voxels along the longest side; default: two for every pixel of the photos, at most
    200."""

    smooth: Number = None
    """Mesh: filter over the depth, in voxels; 0 for none; default: 1."""

    watertight: bool = False
    """Mesh: close it where no camera has looked."""

    box: Annotated[tuple[float, float, float, float, float, float] | None, optional("X")] = None
    """Mesh: lower and upper corner of what is meshed, world units; default: around the points."""

    faces: Count = None
    """Mesh: at most so many triangles."""

    texture: Count = None
    """Mesh: bake colours into a picture of so many pixels a side instead of the vertices."""

    steps: Count = None
    """Splats of a run of PAPR: steps of their fit to its pictures; default: 1200."""

    split: Annotated[float | None, optional("TOLERANCE")] = None
    """Split Gaussians that the edit bends within themselves by more than this share of their
    thickness, such as 0.3; default: split none."""

    cameras: Annotated[Path | None, optional("FILE")] = None
    """Depth, cameras, nerfstudio: take the cameras of this transforms file; default: those of the
    scene's training views, or an orbit."""

    orbit: Count = None
    """Depth, cameras, nerfstudio: so many cameras once around the object."""

    size: Annotated[tuple[int, int] | None, optional("W H")] = None
    """Width and height of the pictures; default: those of the cameras."""

    no_exr: bool = False
    """Depth: write no EXR files, which need the package OpenEXR."""

    overwrite: bool = False
    """Write into a folder that holds files already."""

    device: DeviceName = "auto"
    """Where to compute; auto takes a GPU where there is one."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Do it; raises PcoreError subclasses for what the user can mend."""
        export(self, Console())


def export(command: ExportCommand, console: Console) -> None:
    """Write what is asked for and say what was written."""
    from pcore.asset.saving import load

    _check(command)
    writer = _writer(command)
    prepare_torch(command.threads)
    asset = load(command.run_folder, device=pick_device(command.device))
    for line in writer(command, asset, console):
        say(console, line)


def _check(command: ExportCommand) -> None:
    """Refuse options that contradict one another, before anything is loaded."""
    if command.frames is not None:
        if command.edit is None or command.time is not None:
            raise InputError(
                "--frames: expected --edit with a file that has keyframes, and no --time, got "
                f"{'no --edit' if command.edit is None else '--time'}"
            )
        if command.frames < 1:
            raise InputError(f"--frames: expected at least 1, got {command.frames}")
    if command.cameras is not None and command.orbit is not None:
        raise InputError("expected one of --orbit and --cameras, got both")


def _writer(command: ExportCommand) -> Callable[[ExportCommand, Asset, Console], list[str]]:
    """What writes this kind; missing packages and impossible names are told before any work."""
    from pcore.cli import export_object, export_views

    if command.to in ("depth", "cameras", "nerfstudio"):
        export_views.check(command)
        return export_views.write
    export_object.check(command)
    return {
        "ply": export_object.write_points,
        "splats": export_object.write_splats,
    }.get(command.to, export_object.write_mesh)
