"""`pcore animate RUN`: a video of a run under an edit file with keyframes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.console import counting, say
from pcore.cli.diagnosing import note, note_edit
from pcore.cli.light import LightChoice
from pcore.cli.options import Count, Folder, Number, Samples, check_given_samples, optional
from pcore.cli.output import pictures_folder
from pcore.cli.runtime import DeviceName, pick_device, prepare_torch
from pcore.cli.torchrun import is_first, joined_ranks
from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.asset.asset import Asset
    from pcore.asset.posed_asset import Posed
    from pcore.editing.animation import Animation
    from pcore.geometry.camera import Camera
    from pcore.render.image import Image
    from pcore.training.ranks import Ranks


@dataclass(frozen=True, kw_only=True)
class AnimateCommand:
    """Film a run while its edit goes through its keyframes."""

    run_or_file: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of a run, or a model.safetensors."""

    edit: Annotated[Path, arg(metavar="FILE")]
    """Edit file (JSON, version 2) with keyframes; the first frame shows the first of them."""

    frames: Annotated[int, arg(metavar="N")] = 60
    """How many frames, evenly from the first keyframe to the last."""

    span: Annotated[tuple[float, float] | None, optional("FROM TO")] = None
    """Times of the first and the last frame; default: those of the first keyframe and the last."""

    output: Annotated[Path | None, optional("VIDEO", "-o")] = None
    """The video, .mp4; replaced if it exists. Without it there must be --frames-dir or --points."""

    frames_dir: Folder = None
    """Folder for every frame as frame_NNN.png with transparency, for other programs."""

    depth: bool = False
    """With --frames-dir: also frame_NNN.npz with depth, camera z in world units, NaN for nothing;
    and alpha."""

    points: Folder = None
    """Folder for the points of every frame as frame_NNN.ply, or .glb."""

    points_format: Literal["ply", "glb"] = "ply"
    """Format of the points: PLY, or binary glTF (y up, as its readers expect)."""

    orbit: bool = False
    """Go once around the object meanwhile; without, the camera stands still."""

    cameras: Annotated[Path | None, optional("FILE")] = None
    """Take the cameras of this transforms file as a path; frames between them are interpolated."""

    fps: Annotated[int, arg(metavar="N")] = 30
    """Frames per second."""

    size: Annotated[tuple[int, int] | None, optional("W H")] = None
    """Width and height in pixels; default: that of the scene's images."""

    scene: Folder = None
    """Folder of the scene the orbit is fitted to; default: the one the run was trained on."""

    elevation: Number = None
    """Height of the camera above the horizon in degrees; default: mean of the training cameras."""

    rays: Literal["aware", "plain"] = "aware"
    """How deformed points are seen: aware of the deformation, or plain as in the paper."""

    light: LightChoice = None
    """still: the light and its shadows stay where they are; baked: every point keeps the brightness
    of the photos. Default: still where the run has a light (`pcore light`) and rays are aware, else
    baked."""

    samples: Samples = None
    """Rays per pixel: 1, 4, 9, ...; default: those of the model."""

    overwrite: bool = False
    """Write points or frames into a folder that holds files already."""

    device: DeviceName = "auto"
    """Where to compute; auto takes a GPU where there is one."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Do it; raises PcoreError subclasses for what the user can mend."""
        animate(self, Console(quiet=not is_first()))


def animate(command: AnimateCommand, console: Console) -> None:
    """Move the points through all frames, film them, write them.

    Every frame is bound before the first is rendered, so that a bad one costs no waiting. The
    processes that torchrun started take turns at the frames; the first of them writes.
    """
    from pcore.data.video import require_video

    _check(command)
    if command.output is not None:
        require_video()
    prepare_torch(command.threads)
    device = pick_device(command.device)
    with joined_ranks(device, learns=False) as ranks:
        _animate(command, device, ranks, console)


def _animate(command: AnimateCommand, device: str, ranks: Ranks, console: Console) -> None:
    import torch

    from pcore.asset.saving import load
    from pcore.editing.animation import load_animation

    asset = load(command.run_or_file, device=device)
    moved = _frames(load_animation(command.edit), asset, command, console)
    if command.points is not None and ranks.rank == 0:
        pictures_folder(command.points, overwrite=command.overwrite)
        _write_points(command.points, moved, command.points_format)
        say(console, f"{len(moved)} files of points in {command.points}")
    if command.output is None and command.frames_dir is None:
        return
    if command.frames_dir is not None and ranks.rank == 0:
        pictures_folder(command.frames_dir, overwrite=command.overwrite)
    cameras = _cameras(command, asset, moved, console)
    # Over black, colours and opacity are kept apart.
    shown = asset if command.frames_dir is None else asset.over((0.0, 0.0, 0.0))
    everywhere = torch.cat([one.points for one in moved])
    ranks.agree({"posed points": everywhere, "cameras": cameras})
    detail = shown.film_detail(moved, cameras)

    def frame(n: int) -> Image:
        return shown.render(moved[n], cameras[n], samples=command.samples, detail=detail).cpu()

    film = ranks.in_turn(len(moved), frame)
    if ranks.rank > 0:
        deque(film, maxlen=0)
        return
    _film(command, film, asset.provenance.background, len(moved), console)
    for place in (command.output, command.frames_dir):
        if place is not None:
            say(console, f"{len(moved)} frames in {place}")


def _check(command: AnimateCommand) -> None:
    check_given_samples(command.samples)
    if command.output is None and command.points is None and command.frames_dir is None:
        raise InputError("expected -o VIDEO.mp4, --frames-dir or --points FOLDER, got none")
    if command.span is not None and not -inf < command.span[0] <= command.span[1] < inf:
        raise InputError(f"--span: expected two times in their order, got {command.span}")
    if command.depth and command.frames_dir is None:
        raise InputError("expected --frames-dir FOLDER with --depth, got none")
    if command.output is not None and command.output.suffix.lower() != ".mp4":
        raise InputError(f"{command.output}: expected a video that ends in .mp4")
    if command.orbit and command.cameras is not None:
        raise InputError("expected one of --orbit and --cameras, got both")
    if command.output is not None and not command.output.absolute().parent.is_dir():
        raise InputError(
            f"{command.output}: expected an existing folder to write to, got "
            f"{command.output.parent}"
        )


def _frames(
    animation: Animation, asset: Asset, command: AnimateCommand, console: Console
) -> list[Posed]:
    """The object in every frame; equal times are computed once."""
    from pcore.editing.animation import evenly

    known: dict[float, Posed] = {}
    times = animation.times(command.frames)
    if command.span is not None:
        times = evenly(*command.span, command.frames)
    with counting(console, "edits") as tell:
        for number, time in enumerate(times, start=1):
            if time not in known:
                known[time] = asset.pose(
                    animation, time=time, rays=command.rays, light=command.light
                )
            tell(number, len(times))
    found = [line for posed in known.values() for line in posed.notes]
    note_edit(console, found, command.run_or_file, command.edit)
    return [known[time] for time in times]


def _write_points(folder: Path, moved: list[Posed], suffix: str) -> None:
    from pcore.asset.picture_set import frame_names
    from pcore.data.points import save_point_glb, save_points

    save = save_points if suffix == "ply" else save_point_glb
    for name, posed in zip(frame_names(len(moved)), moved, strict=True):
        save(folder / f"{name}.{suffix}", posed.points)


def _cameras(
    command: AnimateCommand, asset: Asset, moved: list[Posed], console: Console
) -> list[Camera]:
    import torch

    from pcore.capture.load import camera_notes
    from pcore.cli import cameras
    from pcore.geometry.camera_path import path_through
    from pcore.geometry.orbit import growth

    if command.cameras is not None:
        given = cameras.cameras_of_file(command.cameras, command.size)
        note(console, camera_notes(command.cameras))
        everywhere = torch.cat([one.points for one in moved])
        cameras.that_see(given, everywhere, str(command.cameras))
        return path_through([camera for _, camera in given], len(moved))
    wish = cameras.OrbitWish(
        count=len(moved) if command.orbit else 1,
        size=command.size,
        elevation_degrees=command.elevation,
    )
    folder = command.scene or asset.record.scene_folder
    if folder is None:
        views = cameras.orbit_of_cloud(torch.cat([one.points for one in moved]), wish)
    else:
        scene = asset.scene(folder)
        note(console, scene.notes)
        # One distance for all frames: the farthest that any of them needs.
        reach = max(growth(asset.points, one.points, scene.center) for one in moved)
        views = cameras.orbit_of_scene(scene, wish, console=console, scale=reach)
    return path_through([camera for _, camera in views], len(moved))


def _film(
    command: AnimateCommand,
    film: Iterator[Image],
    background: tuple[float, float, float],
    count: int,
    console: Console,
) -> None:
    """Write every picture where it is asked for; those with --frames-dir were taken over black."""
    import torch

    from pcore.asset.picture_set import frame_names
    from pcore.data.video import VideoWriter

    names = frame_names(count)
    with ExitStack() as stack:
        video = None
        if command.output is not None:
            video = stack.enter_context(VideoWriter(command.output, fps=command.fps))
        tell = stack.enter_context(counting(console, "frames"))
        for number, picture in enumerate(film, start=1):
            rgb = picture.rgb
            if command.frames_dir is not None:
                _write_frame(command.frames_dir / names[number - 1], picture, depth=command.depth)
                rgb = rgb + (1 - picture.alpha.unsqueeze(-1)) * torch.tensor(background).to(rgb)
            if video is not None:
                video.add(rgb)
            tell(number, count)


def _write_frame(stem: Path, picture: Image, *, depth: bool) -> None:
    from pcore.data.pictures import write_raw, write_rgba

    write_rgba(stem.with_suffix(".png"), picture.rgb, picture.alpha)
    if depth:
        write_raw(stem.with_suffix(".npz"), depth=picture.depth, alpha=picture.alpha)
