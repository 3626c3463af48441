"""`pcore export` of views of an object: depth and normals, cameras, data sets of pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pcore.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from pcore.asset.asset import Asset, Posed
    from pcore.cli.cameras import Named
    from pcore.cli.export import ExportCommand
    from pcore.geometry.camera import Camera
    from pcore.render.image import Image

Shot = tuple[str, "Camera", "Posed"]


def check(command: ExportCommand) -> None:
    """Raise InputError or DependencyError for what cannot be written, before any work."""
    from pcore.data.depth_files import require_exr

    if command.to == "depth" and not command.no_exr:
        require_exr()
    if command.to != "depth" and command.frames is not None:
        raise InputError(f"--frames: expected --to depth or an object, got --to {command.to}")
    if command.orbit is not None and command.orbit < 1:
        raise InputError(f"--orbit: expected at least 1 camera, got {command.orbit}")


def write(command: ExportCommand, asset: Asset, console: Console) -> list[str]:
    """Write depth and normals, cameras, or a data set."""
    from pcore.cli.output import export_folder

    shots = _shots(command, asset)
    export_folder(command.output, overwrite=command.overwrite)
    if command.to == "depth":
        return _write_depth(command, asset, shots, console)
    named = [(name, camera) for name, camera, _ in shots]
    posed = shots[0][2]
    notes = [f"  note: {line}" for line in posed.notes]
    if command.to == "cameras":
        return [*_write_cameras(command.output, named, posed), *notes]
    from pcore.asset.picture_set import save_picture_set
    from pcore.cli.results import counting

    with counting(console, "pictures") as tell:
        save_picture_set(command.output, asset, posed, named, progress=tell)
    return [f"{command.output}: {len(named)} pictures and transforms.json", *notes]


def _shots(command: ExportCommand, asset: Asset) -> list[Shot]:
    """Names, cameras and poses of all pictures."""
    from pcore.editing.animation import load_animation
    from pcore.geometry.camera_path import path_through

    if command.frames is None or command.edit is None:
        posed = asset.pose(command.edit, time=command.time)
        return [(name, camera, posed) for name, camera in _views(command, asset, posed)]
    times = load_animation(command.edit).times(command.frames)
    poses = [asset.pose(command.edit, time=time) for time in times]
    views = _views(command, asset, poses[-1])
    path = path_through([camera for _, camera in views], len(poses))
    digits = max(3, len(str(len(poses) - 1)))
    named = ((f"frame_{k:0{digits}}", camera) for k, camera in enumerate(path))
    return [(*one, posed) for one, posed in zip(named, poses, strict=True)]


def _views(command: ExportCommand, asset: Asset, posed: Posed) -> Named:
    """Cameras of a file, of the scene's training views, or of an orbit."""
    from pcore.cli import cameras

    if command.cameras is not None:
        given = cameras.cameras_of_file(command.cameras, command.size)
        return cameras.that_see(given, posed.points, str(command.cameras))
    folder = command.scene or asset.record.scene_folder
    wish = cameras.OrbitWish(count=command.orbit or 24, size=command.size)
    if folder is None:
        return cameras.orbit_of_cloud(posed.points, wish)
    scene = asset.scene(folder)
    if command.orbit is not None:
        return cameras.orbit_of_scene(scene, wish)
    split = "train" if "train" in scene.splits else scene.splits[0]
    return cameras.cameras_of_split(scene, split, command.size)


def _write_cameras(folder: Path, named: Named, posed: Posed) -> list[str]:
    from pcore.data.camera_output import TRANSFORMS, save_colmap, save_transforms

    model = folder / "sparse" / "0"
    model.mkdir(parents=True, exist_ok=True)
    save_transforms(folder / TRANSFORMS, named)
    save_colmap(model, named, posed.points, None)
    return [f"{folder}: {len(named)} cameras in {TRANSFORMS} and in sparse/0 (COLMAP, text)"]


def _write_depth(
    command: ExportCommand, asset: Asset, shots: list[Shot], console: Console
) -> list[str]:
    from pcore.cli.results import counting
    from pcore.data.camera_output import TRANSFORMS, save_transforms
    from pcore.data.depth_files import depth_step
    from pcore.data.whole_file import save_json

    folder = command.output
    # One step for all pictures, before any is taken: what is behind the farthest point is nothing.
    step = depth_step(1.05 * max(float(c.depth(p.points).max()) for _, c, p in shots))
    seen = 0
    with counting(console, "pictures") as tell:
        for number, (name, camera, posed) in enumerate(shots, start=1):
            image = asset.render(posed, camera).cpu()
            seen += _write_picture(folder, name, camera, image, step, exr=not command.no_exr)
            tell(number, len(shots))
    if not seen:
        raise InputError(
            f"{folder}: no depth in any of the {len(shots)} picture(s); do the cameras look at the "
            "object, and was the run trained to its end?"
        )
    named = [(name, camera) for name, camera, _ in shots]
    keys = {
        "depth_unit_scale_factor": step,
        "frames": {name: {"depth_file_path": f"{name}_depth.png"} for name, _ in named},
    }
    files = {name: f"{name}_depth.png" for name, _ in named}
    save_transforms(folder / TRANSFORMS, named, files=files, keys=keys)
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
    import torch

    from pcore.data.depth_files import save_depth_png, save_exr
    from pcore.data.pictures import normal_picture, write_png
    from pcore.render.image import whole_normals

    depth = torch.where(image.alpha >= 0.5, image.depth, torch.nan)
    facing = whole_normals(image, camera)
    save_depth_png(folder / f"{name}_depth.png", depth, step)
    write_png(folder / f"{name}_normals.png", normal_picture(facing, camera.world_from_camera))
    if exr:
        save_exr(folder / f"{name}_depth.exr", Y=depth)
        x, y, z = facing.nan_to_num(0.0).unbind(dim=-1)
        save_exr(folder / f"{name}_normals.exr", R=x, G=y, B=z)
    return bool(depth.isfinite().any())
