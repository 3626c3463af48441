"""Which cameras a picture is taken from: those of a file, of a split, or an orbit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from torch import Tensor

from pcore.asset.picture_set import frame_names
from pcore.capture.coverage import ONE_SIDE, coverage
from pcore.capture.load import load_cameras
from pcore.cli.console import say
from pcore.data.held_cameras import held_cameras
from pcore.data.scene import Scene
from pcore.errors import InputError, SceneError
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_around, orbit_like

Size = tuple[int, int]
Named = list[tuple[str, "Camera"]]

_SAME_SHAPE = 0.01


@dataclass(frozen=True, kw_only=True)
class OrbitWish:
    """What is asked of an orbit; None leaves it to the scene, or to a default without one."""

    count: int
    size: Size | None = None
    fov_degrees: float | None = None
    elevation_degrees: float | None = None


def cameras_of_file(path: Path, size: Size | None, fallback: Size | None = None) -> Named:
    """Cameras of a transforms file, in its order.

    `size` wins over the size in the file; `fallback` serves where the file has none.
    """
    width, height = size or (None, None)
    try:
        return load_cameras(path, width=width, height=height)
    except SceneError as error:
        if size is None and "says no image size" in str(error):
            if fallback is not None:
                return load_cameras(path, width=fallback[0], height=fallback[1])
            raise InputError(
                f"{path}: says no image size; add 'w' and 'h' to it, or use --size W H"
            ) from error
        raise


def that_see(views: Named, points: Tensor, what: str) -> Named:
    """Return cameras; refuse them when none has a point in its picture, or close beside it.

    Args:
        views: cameras by name.
        points: (N, 3) world units.
        what: where the cameras come from.
    """
    places = points.detach().cpu()
    for _, camera in views:
        column, row, depth = camera.project(places)
        near = (depth > 0) & ((column / camera.width - 0.5).abs() < 1)
        if bool((near & ((row / camera.height - 0.5).abs() < 1)).any()):
            return views
    raise InputError(
        f"{what}: 0 of {len(points):,} points lie in what its {len(views)} camera(s) see; are they "
        "in the coordinates of the scene, camera-to-world with OpenGL axes?"
    )


def cameras_of_split(scene: Scene, split: str, size: Size | None) -> Named:
    """Cameras of a split of a scene, named like its views."""
    return [(view.name, _resized(view.camera, size)) for view in scene.split(split)]


def training_cameras(scene: Scene, size: Size | None = None) -> Named:
    """Cameras of the training views; of a scene without any, those of its first split."""
    return cameras_of_split(scene, "train" if "train" in scene.splits else scene.splits[0], size)


def orbit_of_scene(
    scene: Scene, wish: OrbitWish, *, scale: float = 1.0, console: Console | None = None
) -> Named:
    """Orbit that resembles the training cameras of a scene, `scale` times as far away.

    Captures are upright as their photos are seen. Where all stand on one side the orbit swings
    before the object, and that is said: what no photo shows is a guess.
    """
    taken = [camera for _, camera in training_cameras(scene)]
    views = scene.split("train" if "train" in scene.splits else scene.splits[0])
    cover = coverage(held_cameras(views), scene.center)
    up, arc = None, None
    if scene.layout != "NeRF-Synthetic":
        up = cover.up
    if up is not None and cover.gap > ONE_SIDE:
        width = 360 - cover.gap
        arc = math.radians(cover.gap_middle + 180), math.radians(width)
        if console is not None:
            said = f"the orbit swings through the {width:.0f} degrees that they cover"
            text = f"photos were taken from one side: {said}"
            say(console, text)
    cameras = orbit_like(
        taken,
        scene.center,
        wish.count,
        elevation=_radians(wish.elevation_degrees),
        scale=scale,
        size=wish.size,
        up=up,
        arc=arc,
    )
    return _numbered(cameras)


def orbit_of_cloud(points: Tensor, wish: OrbitWish) -> Named:
    """Orbit from which all of `points` (N, 3), world units, are in the picture."""
    asked: dict[str, Any] = {}
    if wish.size is not None:
        asked["size"] = wish.size
    if wish.fov_degrees is not None:
        asked["angle_x"] = math.radians(wish.fov_degrees)
        if not 0 < asked["angle_x"] < math.pi:
            raise InputError(f"--fov: expected degrees between 0 and 180, got {wish.fov_degrees}")
    elevation = _radians(wish.elevation_degrees)
    if elevation is not None:
        asked["elevation"] = elevation
    return _numbered(orbit_around(points, wish.count, **asked))


def _numbered(cameras: list[Camera]) -> Named:
    return list(zip(frame_names(len(cameras)), cameras, strict=True))


def _radians(elevation: float | None) -> float | None:
    if elevation is None:
        return None
    if not -90 < elevation < 90:
        raise InputError(
            "--elevation: expected degrees between -90 and 90 (straight above there is no way "
            f"up in the picture), got {elevation:g}"
        )
    return math.radians(elevation)


def _resized(camera: Camera, size: Size | None) -> Camera:
    if size is None:
        return camera
    width, height = size
    if min(size) < 1 or abs(width * camera.height / (height * camera.width) - 1) > _SAME_SHAPE:
        raise InputError(
            f"--size: expected the shape of the images, which are {camera.width} x "
            f"{camera.height}, got {width} x {height}; use a multiple of it, or --cameras with a "
            "file of your own"
        )
    return camera.resized(width, height)
