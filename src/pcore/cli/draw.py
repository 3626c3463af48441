"""Rendering many views into files, with a bar."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from torch import Tensor

from pcore.cli.cameras import Named
from pcore.cli.console import bar
from pcore.cli.diagnosing import note
from pcore.data.pictures import depth_picture, depth_range, normal_picture, write_png, write_raw
from pcore.data.video import VideoWriter
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.render.image import Image, whole_normals
from pcore.training.ranks import current_ranks

FPS = 30
_FAINT = 0.02
"""A picture without a pixel that is more opaque shows nothing."""


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """Which files are written; colours always are, as PNG or in the video."""

    png: bool
    """NAME.png of every view."""
    video: bool
    """All views as orbit.mp4."""
    depth: bool = False
    """NAME_depth.png and orbit_depth.mp4."""
    normals: bool = False
    """NAME_normals.png and orbit_normals.mp4."""
    raw: bool = False
    """NAME.npz of every view."""


def draw(
    take: Callable[..., Image],
    points: Tensor,
    views: Named,
    output: Path,
    wanted: Wanted,
    console: Console,
) -> list[Path]:
    """Render views of an object and write them into the folder `output`.

    Processes that work together take turns; the first of them has all the files.

    Args:
        take: makes the picture of a camera and tells `progress`, as `Asset.render` does.
        points: (N, 3) of what is rendered, world units; their extent sets the shades of depth.
        views: cameras by name.
        output: folder that is there.
        wanted: which files.
        console: where the bar goes.

    Returns:
        The files, videos first.
    """
    shades = depth_range(points, [camera for _, camera in views])
    files: list[Path] = []
    empty: list[str] = []
    try:
        with ExitStack() as stack:
            films = _Films(output, stack)
            tell = stack.enter_context(_bar(console, len(views)))

            def picture_of(index: int) -> Image:
                def told(share: float) -> None:
                    tell(index + share)

                return take(views[index][1], progress=told).cpu()

            pictures = current_ranks().in_turn(len(views), picture_of)
            for (name, camera), picture in zip(views, pictures, strict=False):
                if not bool((picture.alpha > _FAINT).any()):
                    empty.append(name)
                layers = _layers(picture, camera, wanted, shades)
                if wanted.video:
                    films.add(layers)
                files += _write(output, name, picture, camera, layers, wanted)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"complete files: {len(files)}, in {output}; no video was written. The same command "
            "with --overwrite begins again"
        ) from None
    _tell_empty(empty, len(views), output, console)
    return [*films.paths, *files]


def _tell_empty(empty: list[str], count: int, output: Path, console: Console) -> None:
    """Say which pictures show nothing; InputError when all of them do."""
    if empty and len(empty) == count:
        raise InputError(
            f"{output}: nothing is to be seen in any of the {count} picture(s) written; do the "
            "cameras look at the object, in the coordinates of the scene, and was the run trained "
            "to its end?"
        )
    if empty:
        some = f"{', '.join(empty[:5])}{', ...' * (len(empty) > 5)}"
        note(console, [f"nothing is to be seen in {len(empty)} of {count} pictures: {some}"])


def _layers(
    picture: Image, camera: Camera, wanted: Wanted, shades: tuple[float, float]
) -> dict[str, Tensor]:
    """Colours (H, W, 3) by the ending of their file's name."""
    layers = {"": picture.rgb}
    if wanted.depth:
        near, far = shades
        layers["_depth"] = depth_picture(picture.depth, picture.alpha, near=near, far=far)
    if wanted.normals:
        layers["_normals"] = normal_picture(
            whole_normals(picture, camera), camera.world_from_camera
        )
    return layers


def _write(
    output: Path,
    name: str,
    picture: Image,
    camera: Camera,
    layers: dict[str, Tensor],
    wanted: Wanted,
) -> list[Path]:
    files: list[Path] = []
    if wanted.png:
        for ending, rgb in layers.items():
            files.append(output / f"{name}{ending}.png")
            write_png(files[-1], rgb)
    if wanted.raw:
        arrays = {
            "rgb": picture.rgb,
            "alpha": picture.alpha,
            "depth": picture.depth,
            "surface": picture.surface,
        }
        if wanted.normals:
            arrays["normals"] = whole_normals(picture, camera)
        files.append(output / f"{name}.npz")
        write_raw(files[-1], **arrays)
    return files


class _Films:
    """One video per layer, begun with the first frame."""

    def __init__(self, output: Path, stack: ExitStack) -> None:
        self._output, self._stack = output, stack
        self._writers: dict[str, VideoWriter] = {}

    @property
    def paths(self) -> list[Path]:
        return [self._output / f"orbit{ending}.mp4" for ending in self._writers]

    def add(self, layers: dict[str, Tensor]) -> None:
        for ending, rgb in layers.items():
            if ending not in self._writers:
                path = self._output / f"orbit{ending}.mp4"
                self._writers[ending] = self._stack.enter_context(VideoWriter(path, fps=FPS))
            self._writers[ending].add(rgb)


@contextmanager
def _bar(console: Console, total: int) -> Generator[Callable[[float], None]]:
    progress = bar(console)
    task = progress.add_task("views", total=total)
    with progress:
        yield lambda done: progress.update(task, completed=done)
