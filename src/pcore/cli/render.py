"""`pcore render RUN`: pictures and orbits of a run, as it is or deformed by an edit file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.console import say
from pcore.cli.diagnosing import note, note_edit
from pcore.cli.light import LightChoice
from pcore.cli.options import Count, Folder, Number, Output, Samples, check_given_samples, optional
from pcore.cli.output import pictures_folder
from pcore.cli.runtime import DeviceName, pick_device, prepare_torch
from pcore.cli.torchrun import is_first, joined_ranks
from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.asset.asset import Asset
    from pcore.asset.posed_asset import Posed
    from pcore.cli.cameras import Named
    from pcore.training.ranks import Ranks

_FRAMES = 60


@dataclass(frozen=True, kw_only=True)
class RenderCommand:
    """Render a run: an orbit as video, the views of a split, or any cameras; deformed or not."""

    run_or_file: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of a run, or a model.safetensors."""

    edit: Annotated[Path | None, optional("FILE")] = None
    """Edit file (JSON) to deform the points with; bound to the canonical cloud."""

    time: Number = None
    """For an edit file with keyframes: the time to show."""

    rays: Literal["aware", "plain"] = "aware"
    """How deformed points are seen: aware of the deformation, or plain as in the paper."""

    cameras: Annotated[Path | None, optional("FILE")] = None
    """Take the cameras of this transforms file (NeRF-Synthetic form); no images are needed."""

    split: Annotated[Literal["train", "val", "test"] | None, optional("{train,val,test}")] = None
    """Take the cameras of this split of the scene."""

    orbit: Count = None
    """Go once around the object in so many frames (the default: 60) and write an MP4."""

    output: Output = None
    """Folder for the pictures; default: a new one in RUN/renders, named after cameras and
    edit."""

    raw: bool = False
    """Also write an .npz per view: rgb (unclamped), alpha, depth, surface; float32, world units."""

    depth: bool = False
    """Also write depth as pictures, one range of colours for all views."""

    normals: bool = False
    """Also write normals of the surface as pictures; with --raw in world axes as well."""

    light: LightChoice = None
    """still: the light and its shadows stay where they are, and what turns away from it becomes
    darker; baked: every point keeps the brightness of the photos, as in the paper. Default: still
    where the run has a light (`pcore light`) and rays are aware, else baked."""

    samples: Samples = None
    """Rays per pixel: 1, 4, 9, ...; default: those of the model (4 of `tiny` and `fast`, 1 of
    `paper` and official checkpoints), with --fast 1."""

    fast: bool = False
    """Leave out the colours of points with a weight below 0.03 on a ray, and send one ray per
    pixel: less time, and not exact. Measured on trained `tiny` models, with equally many rays: PSNR
    against the exact picture 60 dB or more, no colour off by more than 0.021 of 1."""

    frames: bool = False
    """Write the frames of an orbit as PNG files too."""

    size: Annotated[tuple[int, int] | None, optional("W H")] = None
    """Width and height of the pictures in pixels; default: that of the scene's images."""

    scene: Folder = None
    """Folder of the scene for --split and --orbit; default: the one the run was trained on."""

    factor: Count = None
    """Down-scaling of the scene's image size; default: that of the training."""

    fov: Number = None
    """Horizontal field of view of an orbit in degrees; fits the orbit to the points."""

    elevation: Number = None
    """Height of the orbit above the horizon in degrees; default: mean of the training cameras."""

    overwrite: bool = False
    """Write into a folder that holds files already, and replace those of the same name."""

    device: DeviceName = "auto"
    """Where to compute; auto takes a GPU where there is one."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Render; raises PcoreError subclasses for what the user can mend."""
        render_run(self, Console(quiet=not is_first()))


def render_run(command: RenderCommand, console: Console) -> None:
    """Render what the command asks for, write the files and say where they are.

    The processes that torchrun started take turns at the views; the first of them writes.
    """
    _check(command)
    prepare_torch(command.threads)
    device = pick_device(command.device)
    with joined_ranks(device, learns=False) as ranks:
        _render(command, device, ranks, console)


def _render(command: RenderCommand, device: str, ranks: Ranks, console: Console) -> None:
    from pcore.asset.saving import load
    from pcore.cli.draw import Wanted, draw
    from pcore.data.video import require_video

    asset = load(command.run_or_file, device=device)
    posed = asset.pose(command.edit, time=command.time, rays=command.rays, light=command.light)
    note_edit(console, posed.notes, command.run_or_file, command.edit)
    views = _views(command, asset, posed, console)
    if _films(command):
        require_video()
    output = command.output or ranks.from_first(_default_output(command))
    ranks.agree({"posed points": posed.points, "cameras": [camera for _, camera in views]})
    if ranks.rank == 0:
        pictures_folder(output, overwrite=command.overwrite)
    wanted = Wanted(
        png=command.frames or not _films(command),
        video=_films(command),
        depth=command.depth,
        normals=command.normals,
        raw=command.raw,
    )
    detail = None
    if _films(command):
        detail = asset.film_detail([posed] * len(views), [camera for _, camera in views])
    how = partial(asset.render, posed, samples=command.samples, fast=command.fast, detail=detail)
    files = draw(how, posed.points, views, output, wanted, console)
    _tell(console, views, output, files)


def _check(command: RenderCommand) -> None:
    check_given_samples(command.samples)
    given = [name for name in ("cameras", "split", "orbit") if getattr(command, name) is not None]
    if len(given) > 1:
        names = " and ".join(f"--{name}" for name in given)
        raise InputError(f"expected one of --cameras, --split and --orbit, got {names}")
    for name in ("fov", "elevation", "frames"):
        if getattr(command, name) and not _films(command):
            raise InputError(f"--{name} is for orbits: leave out --{given[0]}, or --{name}")


def _films(command: RenderCommand) -> bool:
    return command.cameras is None and command.split is None


def _image_size(folder: Path, factor: int) -> tuple[int, int]:
    """Width and height of the images of a scene."""
    from pcore.capture.load import load_scene

    scene = load_scene(folder, factor=factor)
    camera = scene.split(scene.splits[0])[0].camera
    return camera.width, camera.height


def _views(command: RenderCommand, asset: Asset, posed: Posed, console: Console) -> Named:
    from pcore.capture.load import camera_notes, load_scene
    from pcore.cli import cameras
    from pcore.geometry.orbit import growth

    record = asset.record
    folder = command.scene or record.scene_folder
    factor = record.factor if command.factor is None else command.factor
    if command.cameras is not None:
        fallback = None if folder is None else _image_size(folder, factor)
        found = cameras.cameras_of_file(command.cameras, command.size, fallback)
        note(console, camera_notes(command.cameras))
        return cameras.that_see(found, posed.points, str(command.cameras))
    if command.split is not None:
        if folder is None:
            raise InputError(
                f"{command.run_or_file}: the scene it was trained on "
                f"({record.scene or 'not recorded'}) is not a folder here; give it "
                "with --scene, or use --cameras or --orbit"
            )
        scene = load_scene(folder, factor=factor)
        found = cameras.cameras_of_split(scene, command.split, command.size)
        note(console, scene.notes)
        return cameras.that_see(found, posed.points, f"{folder}, {command.split}")
    wish = cameras.OrbitWish(
        count=_FRAMES if command.orbit is None else command.orbit,
        size=command.size,
        fov_degrees=command.fov,
        elevation_degrees=command.elevation,
    )
    if folder is None or command.fov is not None:
        if folder is None:
            say(console, "no scene at hand: the orbit is fitted to the points")
        return cameras.orbit_of_cloud(posed.points, wish)
    scene = asset.scene(folder, factor=factor)
    note(console, scene.notes)
    # An edit that makes the object larger moves the cameras back.
    reach = growth(asset.points, posed.points, scene.center)
    return cameras.orbit_of_scene(scene, wish, console=console, scale=reach)


def _default_output(command: RenderCommand) -> Path:
    path = command.run_or_file
    renders = (path if path.is_dir() else path.parent) / "renders"
    what = command.cameras.stem if command.cameras else command.split or "orbit"
    wish = renders / (f"{what}-{command.edit.stem}" if command.edit else what)
    if command.overwrite:
        return wish
    # A folder that nobody chose is no reason to refuse: the next one that is free.
    names = chain([wish], (wish.with_name(f"{wish.name}-{n}") for n in count(2)))
    return next(one for one in names if not one.exists() or not any(one.iterdir()))


def _tell(console: Console, views: Named, output: Path, files: list[Path]) -> None:
    sizes = dict.fromkeys(f"{camera.width} x {camera.height}" for _, camera in views)
    names = ", ".join(file.name for file in files[:3]) + ", ..." * (len(files) > 3)
    count = "1 view" if len(views) == 1 else f"{len(views)} views"
    text = f"{count} of {' and '.join(sizes)} pixels in {output}: {names}"
    say(console, text)
