"""`pcore blender export`: a folder that the add-on for Blender imports."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.console import counting, say
from pcore.cli.options import Count, Folder, optional
from pcore.cli.output import pictures_folder
from pcore.cli.runtime import DeviceName, pick_device, prepare_torch
from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.asset.asset import Asset
    from pcore.cli.cameras import Named
    from pcore.geometry.camera import Camera


@dataclass(frozen=True, kw_only=True)
class BlenderExportCommand:
    """Write the points, anchors, cage, proxy and cameras of a run for the add-on for Blender."""

    run_folder: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of a run."""

    output: Annotated[Path, arg(aliases=["-o"], metavar="BUNDLE")]
    """A new or empty folder."""

    cameras: Annotated[Path | None, optional("FILE")] = None
    """Take the cameras of this transforms file; default: those of the scene's training views, or
    an orbit."""

    scene: Folder = None
    """Folder of the scene; default: the one it was trained on."""

    fps: Annotated[int, arg(metavar="N")] = 24
    """Frames per second of the keyframes that come back."""

    resolution: Annotated[int, arg(metavar="N")] = 100
    """Voxels of the proxy mesh along its longest side."""

    overwrite: bool = False
    """Write into a folder that holds files already."""

    device: DeviceName = "auto"
    """Where to compute; auto takes a GPU where there is one."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Do it; raises PcoreError subclasses for what the user can mend."""
        export_bundle(self, Console())


def export_bundle(command: BlenderExportCommand, console: Console) -> None:
    """Write the bundle and say what is in it."""
    from pcore.asset.blender_bundle import save_bundle
    from pcore.asset.saving import load
    from pcore.render.distance_grid import require_marching_cubes

    for name, value in (("--fps", command.fps), ("--resolution", command.resolution - 7)):
        if value < 1:
            least = 8 if name == "--resolution" else 1
            raise InputError(f"{name}: expected at least {least}, got {value + least - 1}")
    require_marching_cubes()
    prepare_torch(command.threads)
    asset = load(command.run_folder, device=pick_device(command.device))
    views, photos = _views(command, asset)
    pictures_folder(command.output, overwrite=command.overwrite)
    with counting(console, "pictures") as tell:
        save_bundle(
            command.output,
            asset,
            views,
            lookers=photos,
            fps=command.fps,
            resolution=command.resolution,
            progress=tell,
        )
    said = f"{command.output}: {len(asset):,} points, {len(views)} cameras, cage, proxy, anchors"
    say(console, said)


def _views(command: BlenderExportCommand, asset: Asset) -> tuple[Named, list[Camera] | None]:
    """Cameras of a file, of the scene's training views, or of an orbit; and those of the photos."""
    from pcore.cli import cameras

    folder = command.scene or asset.record.scene_folder
    if folder is None:
        views, photos = cameras.orbit_of_cloud(asset.points, cameras.OrbitWish(count=24)), None
    else:
        scene = asset.scene(folder)
        views = cameras.training_cameras(scene)
        photos = [camera for _, camera in views]
    if command.cameras is not None:
        given = cameras.cameras_of_file(command.cameras, None)
        views = cameras.that_see(given, asset.points, str(command.cameras))
    return views, photos
