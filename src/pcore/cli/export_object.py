"""`pcore export` of an object itself: its points, its surface, its Gaussians."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
from rich.console import Console
from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.mesh_finish import check_finish, finished, require_finish
from pcore.asset.meshing import Meshing, map_of, mesh_of, moved_mesh
from pcore.asset.painted_points import painted_points, posed_points
from pcore.asset.posing import script_of
from pcore.asset.splats_of_points import edited_splats, likeness, splats_of_points
from pcore.cli.cameras import training_cameras
from pcore.cli.console import counting
from pcore.cli.deform_gaussians import edit_notes
from pcore.cli.export import ExportCommand
from pcore.data.mesh_output import MeshMotion, check_mesh_output, numbered, save_mesh
from pcore.data.mesh_usd import require_usd
from pcore.data.points import save_painted
from pcore.data.splat_file import SplatFile, filter_words, splats_of
from pcore.data.splat_formats import check_splat_output, save_splats
from pcore.editing.animation import load_animation
from pcore.editing.gaussian_edit import edited_gaussians
from pcore.editing.script import EditScript
from pcore.errors import EditError, InputError
from pcore.gaussians.render import Footprint
from pcore.gaussians.spherical_harmonics import brightened
from pcore.geometry.camera import Camera
from pcore.render.distance_grid import require_marching_cubes

_ENDINGS = {"glb": (".glb",), "obj": (".obj",), "usd": (".usd", ".usda", ".usdc")}
_STEPS = 1200


def check(command: ExportCommand) -> None:
    """Raise InputError or DependencyError for what cannot be written, before any work."""
    path, kind = command.output, command.output.suffix.lower()
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: expected an existing folder to write to, got {path.parent}")
    if path.is_dir():
        raise InputError(f"{path} is a folder: expected the name of a file")
    if command.to == "splats":
        check_splat_output(path)
        return
    if command.to == "ply":
        if kind != ".ply":
            raise InputError(f"{path}: expected a file of points that ends in .ply")
        return
    check_mesh_output(path)
    wanted = _ENDINGS.get(command.to, (kind,))
    if kind not in wanted:
        raise InputError(f"{path}: expected a file that ends in {' or '.join(wanted)}")
    require_marching_cubes()
    if kind in _ENDINGS["usd"]:
        require_usd()
    if command.texture is not None or command.faces is not None:
        check_finish(faces=command.faces, texture=command.texture)
        require_finish(texture=command.texture is not None, faces=command.faces is not None)


def write_points(command: ExportCommand, asset: Asset, console: Console) -> list[str]:
    """Write the points with what they look like."""
    times = times_of(command)
    poses = [asset.pose(command.edit, time=time) for time in times]
    with counting(console, "pictures") as tell:
        points = painted_points(asset, _cameras(command, asset), progress=tell)
    several = command.frames is not None
    names = numbered(command.output, len(poses)) if several else [command.output]
    for path, posed in zip(names, poses, strict=True):
        one = posed_points(points, posed)
        save_painted(path, one.positions, one.colors, one.normals, one.confidence)
    notes = {f"  note: {line}" for posed in poses for line in posed.notes}
    return [_said(names, f"{len(asset):,} points"), *sorted(notes)]


def write_mesh(command: ExportCommand, asset: Asset, console: Console) -> list[str]:
    """Write the surface: made at rest, its vertices moved by the edit."""
    # Edits are bound first, so that one that folds costs no waiting.
    maps = [map_of(asset, command.edit, time=time) for time in times_of(command)]
    with counting(console, "pictures") as tell:
        meshed = mesh_of(asset, _cameras(command, asset), _meshing(command), progress=tell)
    mesh = meshed.mesh
    if command.faces is not None or command.texture is not None:
        mesh = finished(meshed, faces=command.faces, texture=command.texture)
    moved = [moved_mesh(mesh, one) for one in maps]
    motion = None
    if command.frames is not None:
        motion = MeshMotion(frames=tuple(one.vertices for one in moved))
    files = save_mesh(command.output, moved[0], motion)
    lines = [_said(files, f"{len(mesh.vertices):,} vertices, {len(mesh):,} triangles")]
    if meshed.crumbs:
        lines.append(f"  note: {meshed.crumbs:,} small parts were left out")
    return lines


def write_splats(command: ExportCommand, asset: Asset, console: Console) -> list[str]:
    """Write Gaussians: those of a run, or ones that are fitted to the pictures of a run of PAPR."""
    times = times_of(command)
    if isinstance(asset.content, GaussianContent):
        footprint = asset.content.footprint
        name = str(command.run_folder)
        gaussians = asset.content.gaussians
        file = splats_of(gaussians, name, flat=footprint.flat, footprint=footprint)
        posed, notes = _carried(command, asset, file, times)
    else:
        posed, notes = _fitted(command, asset, times, console)
    several = command.frames is not None
    names = numbered(command.output, len(times)) if several else [command.output]
    for path, file in zip(names, posed, strict=True):
        notes += save_splats(path, file)
    notes += _of_filter(posed[0].footprint, command.output.suffix.lower())
    first = posed[0].gaussians
    head = _said(names, f"{len(first):,} Gaussians of degree {first.degree}")
    return [head, *(f"  note: {line}" for line in dict.fromkeys(notes))]


def _fitted(
    command: ExportCommand, asset: Asset, times: list[float | None], console: Console
) -> tuple[list[SplatFile], list[str]]:
    """Gaussians that look like a run of PAPR at all times, and how near they come."""
    edit, steps = command.edit, _STEPS if command.steps is None else command.steps
    if command.split is not None:
        raise InputError("--split: expected a run of Gaussians, got one of PAPR's points")
    for time in times if edit is not None else []:
        # Before the fit, so that an edit that folds costs no waiting.
        map_of(asset, edit, time=time)
    with counting(console, "pictures and steps") as tell:
        fitted = splats_of_points(asset, _cameras(command, asset), steps=steps, progress=tell)
    moved = [edited_splats(asset, fitted.gaussians, edit, time=time) for time in times]
    notes: list[str] = []
    if fitted.psnr is not None:
        notes.append(f"{fitted.psnr:.1f} dB to pictures of the run that the fit did not see")
    if edit is not None:
        like = likeness(asset, fitted, moved[-1], edit, time=times[-1])
        notes.append(f"{like:.1f} dB to pictures of the edited run, its light baked in")
    name = str(command.run_folder)
    return [splats_of(one, name, footprint=fitted.footprint) for one in moved], notes


def _of_filter(footprint: Footprint | None, kind: str) -> list[str]:
    """How pictures of a written file come out as those of the run."""
    if footprint is None:
        return []
    read = {
        ".ply": "which `pcore import gaussians` reads from a comment of the file",
        ".glb": "which glTF does not hold (`pcore import gaussians` reads .ply, .splat)",
    }.get(kind, "which `pcore import gaussians` must be told")
    notes = [f"their screen filter, {read}: {filter_words(footprint)}"]
    if footprint.antialiased:
        notes.append(
            "they were trained antialiased: switch that on in the viewer (SuperSplat) or trainer "
            "(gsplat: rasterize_mode), or they look a little bolder"
        )
    return notes


def _carried(
    command: ExportCommand, asset: Asset, file: SplatFile, times: list[float | None]
) -> tuple[list[SplatFile], list[str]]:
    """Gaussians of a run at all times, and what is odd about the edit."""
    if command.edit is None:
        return [file], []
    scripts: list[EditScript] = [script_of(command.edit, time) for time in times]
    edited = [edited_gaussians(file, script, split=command.split) for script in scripts]
    notes = [line for one in edited for line in (*edit_notes(one), *one.bound.notes)]
    files: list[SplatFile] = []
    for one, time in zip(edited, times, strict=True):
        lit, said = _lit(one.file, asset, command, time)
        files.append(lit)
        notes += said
    return files, notes


def _lit(
    file: SplatFile, asset: Asset, command: ExportCommand, time: float | None
) -> tuple[SplatFile, list[str]]:
    """Edited Gaussians in the light that stands still, as they are drawn; what is to be said."""
    try:
        posed = asset.pose(command.edit, time=time)
    except EditError as error:
        # What may be carried with a note may be too folded to be lit.
        return file, [f"the light of the photos is baked in, for no light can be told: {error}"]
    gains = asset.gains_of(posed)
    if gains is None:
        return file, ["the light of the photos is baked in: `pcore light` estimates it"]
    # A piece of a split Gaussian is lit as the whole.
    gains = gains[file.rows]
    own = file.gaussians
    lit = replace(file, gaussians=replace(own, sh=brightened(own.sh, gains)))
    span = f"{float(gains.min()):.2f} to {float(gains.max()):.2f}"
    return lit, [f"the light stands still: colours are those of the photos times {span}"]


def times_of(command: ExportCommand) -> list[float | None]:
    """Times of all frames that are asked for."""
    if command.frames is None or command.edit is None:
        return [command.time]
    return [*load_animation(command.edit).times(command.frames)]


def _cameras(command: ExportCommand, asset: Asset) -> list[Camera] | None:
    """Cameras of the scene's training views; None where there is no scene."""
    folder = command.scene or asset.record.scene_folder
    if folder is None:
        return None
    return [camera for _, camera in training_cameras(asset.scene(folder))]


def _meshing(command: ExportCommand) -> Meshing:
    how = Meshing(closed=command.watertight, box=_box(command))
    if command.resolution is not None:
        how = replace(how, resolution=command.resolution)
    return how if command.smooth is None else replace(how, smooth=command.smooth)


def _box(command: ExportCommand) -> tuple[Tensor, Tensor] | None:
    if command.box is None:
        return None
    lower, upper = torch.tensor(command.box, dtype=torch.float64).reshape(2, 3)
    if not bool((lower < upper).all()):
        raise InputError(
            "--box: expected the lower corner x y z and then the upper one, got "
            f"{' '.join(f'{x:g}' for x in command.box)}"
        )
    return lower, upper


def _said(files: list[Path], what: str) -> str:
    more = f" to {files[-1].name}" if len(files) > 1 else ""
    return f"{files[0]}{more}: {what}"
