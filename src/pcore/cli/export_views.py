"""`pcore export` of views of an object: depth and normals, cameras, data sets of pictures."""

from __future__ import annotations

from pathlib import Path

import torch
from rich.console import Console
from torch import Tensor

from pcore.asset.asset import Asset, Posed
from pcore.asset.picture_set import frame_names, save_moving_set, save_picture_set
from pcore.cli import cameras
from pcore.cli.cameras import Named
from pcore.cli.console import counting
from pcore.cli.export import ExportCommand
from pcore.cli.export_object import times_of
from pcore.cli.output import pictures_folder
from pcore.data.camera_output import TRANSFORMS, save_colmap, save_transforms
from pcore.data.depth_files import depth_step, require_exr, save_depth_png, save_exr
from pcore.data.pictures import normal_picture, write_png
from pcore.data.whole_file import save_json
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.camera_path import path_through
from pcore.render.image import Image, whole_normals

Moment = tuple[float | None, "Posed"]
"""A time of the edit file, or None, and the object then."""
Shot = tuple[str, "Camera", float | None, "Posed"]


def check(command: ExportCommand) -> None:
    """Raise InputError or DependencyError for what cannot be written, before any work."""
    if command.to == "depth" and not command.no_exr:
        require_exr()
    if command.orbit is not None and command.orbit < 1:
        raise InputError(f"--orbit: expected at least 1 camera, got {command.orbit}")


def write(command: ExportCommand, asset: Asset, console: Console) -> list[str]:
    """Write depth and normals, cameras, or a data set."""
    times = times_of(command)
    moments = [(time, asset.pose(command.edit, time=time)) for time in times]
    views = _views(command, asset, torch.cat([posed.points for _, posed in moments]))
    pictures_folder(command.output, overwrite=command.overwrite)
    if command.to == "depth":
        return _write_depth(command, asset, _shots(command, views, moments), console)
    notes = [f"  note: {line}" for line in moments[0][1].notes]
    if command.to == "cameras":
        return [*_write_cameras(command, views, moments), *notes]
    return [_write_pictures(command, asset, views, moments, console), *notes]


def _shots(command: ExportCommand, views: Named, moments: list[Moment]) -> list[Shot]:
    """Names, cameras, times and poses of the pictures of depth: one for each frame, on a path."""
    if command.frames is None:
        return [(name, camera, *moments[0]) for name, camera in views]
    path = path_through([camera for _, camera in views], len(moments))
    names = frame_names(len(moments))
    return [
        (name, camera, *moment) for name, camera, moment in zip(names, path, moments, strict=True)
    ]


def _views(command: ExportCommand, asset: Asset, points: Tensor) -> Named:
    """Cameras of a file, of the scene's training views, or of an orbit."""
    if command.cameras is not None:
        given = cameras.cameras_of_file(command.cameras, command.size)
        return cameras.that_see(given, points, str(command.cameras))
    folder = command.scene or asset.record.scene_folder
    wish = cameras.OrbitWish(count=command.orbit or 24, size=command.size)
    if folder is None:
        return cameras.orbit_of_cloud(points, wish)
    scene = asset.scene(folder)
    if command.orbit is not None:
        return cameras.orbit_of_scene(scene, wish)
    return cameras.training_cameras(scene, command.size)


def _write_cameras(command: ExportCommand, named: Named, moments: list[Moment]) -> list[str]:
    """Write all cameras with the points of the object; a folder for each frame."""
    folder = command.output
    folders = [folder]
    if command.frames is not None:
        folders = [folder / name for name in frame_names(len(moments))]
    for place, (time, posed) in zip(folders, moments, strict=True):
        # Where nerfstudio keeps it: beside a transforms.json it is no second layout.
        model = place / "colmap" / "sparse" / "0"
        model.mkdir(parents=True, exist_ok=True)
        save_transforms(place / TRANSFORMS, named, times=[time] * len(named))
        save_colmap(model, named, posed.points, None)
    where = folder if command.frames is None else f"{folders[0]} to {folders[-1].name}"
    return [f"{where}: {len(named)} cameras in {TRANSFORMS} and in colmap/sparse/0 (COLMAP, text)"]


def _write_pictures(
    command: ExportCommand, asset: Asset, named: Named, moments: list[Moment], console: Console
) -> str:
    """Write pictures of all cameras; of all times where frames are asked for."""
    folder = command.output
    with counting(console, "pictures") as tell:
        if command.frames is None:
            save_picture_set(folder, asset, moments[0][1], named, progress=tell)
            return f"{folder}: {len(named)} pictures and transforms.json"
        stamped = [(time or 0.0, posed) for time, posed in moments]
        files = save_moving_set(folder, asset, stamped, named, progress=tell)
    names = " and ".join(path.name for path in files)
    return f"{folder}: {len(named)} pictures at each of {len(moments)} times, with {names}"


def _write_depth(
    command: ExportCommand, asset: Asset, shots: list[Shot], console: Console
) -> list[str]:
    folder = command.output
    # One step for all pictures, before any is taken: what is behind the farthest point is nothing.
    step = depth_step(1.05 * max(float(c.depth(p.points).max()) for _, c, _, p in shots))
    seen = 0
    with counting(console, "pictures") as tell:
        for number, (name, camera, _, posed) in enumerate(shots, start=1):
            image = asset.render(posed, camera).cpu()
            seen += _write_picture(folder, name, camera, image, step, exr=not command.no_exr)
            tell(number, len(shots))
    if not seen:
        raise InputError(
            f"{folder}: no depth in any of the {len(shots)} picture(s); do the cameras look at the "
            "object, and was the run trained to its end?"
        )
    named = [(name, camera) for name, camera, _, _ in shots]
    keys = {
        "depth_unit_scale_factor": step,
        "frames": {name: {"depth_file_path": f"{name}_depth.png"} for name, _ in named},
    }
    files = {name: f"{name}_depth.png" for name, _ in named}
    times = [time for _, _, time, _ in shots]
    save_transforms(folder / TRANSFORMS, named, files=files, keys=keys, times=times)
    about = {
        "depth": "camera z",
        "png": "value * step = world units; 0: nothing there",
        "step": step,
        "exr": None if command.no_exr else "Y: camera z, world units; infinity: nothing there",
        "normals": "world axes in .exr; in .png right is red, up green, to the camera blue",
    }
    save_json(folder / "depth.json", about, "description")
    return [f"{folder}: depth and normals of {len(shots)} pictures; a step of a PNG is {step:g}"]


def _write_picture(
    folder: Path, name: str, camera: Camera, image: Image, step: float, *, exr: bool
) -> bool:
    """Write depth and normals of a picture; whether it shows any."""
    depth = torch.where(image.alpha >= 0.5, image.depth, torch.nan)
    facing = whole_normals(image, camera)
    save_depth_png(folder / f"{name}_depth.png", depth, step)
    write_png(folder / f"{name}_normals.png", normal_picture(facing, camera.world_from_camera))
    if exr:
        save_exr(folder / f"{name}_depth.exr", Y=depth)
        x, y, z = facing.nan_to_num(0.0).unbind(dim=-1)
        save_exr(folder / f"{name}_normals.exr", R=x, G=y, B=z)
    return bool(depth.isfinite().any())
