"""Cameras on a circle around an object."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.camera import Camera

_UP = (0.0, 0.0, 1.0)
_PARALLEL = 1e-6
_STEEPEST = math.radians(85)
_MARGIN = 1.05


def orbit_cameras(
    center: Tensor,
    distance: float,
    count: int,
    *,
    elevation: float,
    width: int,
    height: int,
    angle_x: float,
    up: Tensor | None = None,
) -> list[Camera]:
    """Cameras that go once around `center`, evenly spaced, looking at it.

    Args:
        center: (3,) world units.
        distance: from the center to the cameras, world units.
        count: how many; the circle is not closed by a repeated camera.
        elevation: angle above the plane across `up`, radians, strictly between -pi/2 and pi/2.
        width: image width in pixels.
        height: image height in pixels.
        angle_x: horizontal field of view, radians.
        up: (3,) direction that points up in the pictures, of any length; None is +z.

    Raises:
        InputError: a count below 1, a distance that is not positive, or an elevation or up
            direction that leaves the horizon undefined.
    """
    poses = _orbit_poses(center, distance, count, elevation=elevation, up=up)
    return [Camera.from_fov(pose, width=width, height=height, angle_x=angle_x) for pose in poses]


def orbit_like(
    cameras: Sequence[Camera],
    center: Tensor,
    count: int,
    *,
    elevation: float | None = None,
    scale: float = 1.0,
    size: tuple[int, int] | None = None,
    up: Tensor | None = None,
    arc: tuple[float, float] | None = None,
) -> list[Camera]:
    """Orbit at the mean distance and mean elevation of given cameras.

    It begins at the azimuth of the first camera and has that camera's horizontal field of view,
    with square pixels and the center in the middle of the picture.

    Args:
        cameras: at least one, such as the training cameras of a scene.
        center: (3,) what to look at, world units.
        count: how many cameras to make.
        elevation: instead of the mean one, radians.
        scale: factor on the mean distance, such as `growth` of an edited cloud.
        size: (width, height) in pixels; None takes that of the first camera.
        up: as for `orbit_cameras`.
        arc: middle azimuth and width, radians, of a part of the circle to swing in, there and back,
            instead of going around.

    Raises:
        InputError: no cameras, or all of them at the center.
    """
    if not cameras:
        raise InputError("orbit: expected at least one camera to take its shape from, got none")
    offsets = torch.stack([camera.center for camera in cameras]) - center
    distances = offsets.norm(dim=1)
    side, ahead, top = _frame(up)
    if elevation is None:
        heights = (offsets @ top) / distances.clamp_min(1e-12)
        mean = float(torch.asin(heights.clamp(-1, 1)).mean())
        # All cameras may stand straight above, where an orbit has no way up in its pictures.
        elevation = max(-_STEEPEST, min(_STEEPEST, mean))
    poses = _orbit_poses(
        center,
        scale * float(distances.mean()),
        count,
        elevation=elevation,
        up=up,
        start=math.atan2(float(offsets[0] @ ahead), float(offsets[0] @ side)),
        arc=arc,
    )
    first = cameras[0]
    width, height = size or (first.width, first.height)
    angle_x = 2 * math.atan(0.5 * first.width / first.focal[0])
    return [Camera.from_fov(pose, width=width, height=height, angle_x=angle_x) for pose in poses]


def orbit_around(
    points: Tensor,
    count: int = 1,
    *,
    size: tuple[int, int] = (400, 400),
    elevation: float = math.radians(25),
    angle_x: float = math.radians(40),
) -> list[Camera]:
    """Cameras that go once around points, all of which are in the picture.

        camera = pcore.orbit_around(posed.points)[0]

    Args:
        points: (N, 3) world units.
        count: how many; the circle is not closed by a repeated camera.
        size: width and height of the pictures in pixels.
        elevation: angle above the horizon, radians.
        angle_x: horizontal field of view, radians.

    Raises:
        InputError: a count below 1, a field of view of nothing or of all there is, or an elevation
            that leaves the horizon undefined.
    """
    if not 0 < angle_x < math.pi:
        raise InputError(
            f"orbit: expected a field of view between 0 and pi radians, got {angle_x:g}"
        )
    center = 0.5 * (points.amin(dim=0) + points.amax(dim=0))
    width, height = size
    smaller = 2 * math.atan(math.tan(0.5 * angle_x) * min(1.0, height / width))
    return orbit_cameras(
        center,
        fitting_distance(points, center, smaller),
        count,
        elevation=elevation,
        width=width,
        height=height,
        angle_x=angle_x,
    )


def fitting_distance(points: Tensor, center: Tensor, angle: float) -> float:
    """Distance from `center` at which points (N, 3) fit a field of view of `angle` radians."""
    radius = float((points.detach().cpu() - center.cpu()).norm(dim=-1).max())
    return _MARGIN * max(radius, _PARALLEL) / math.sin(0.5 * angle)


def growth(before: Tensor, after: Tensor, center: Tensor) -> float:
    """Return by which factor points (N, 3) reach farther from `center` than before; at least 1."""
    reaches = [
        float((points.cpu() - center.cpu()).norm(dim=-1).max()) for points in (before, after)
    ]
    return max(1.0, reaches[1] / max(reaches[0], _PARALLEL))


def _orbit_poses(
    center: Tensor,
    distance: float,
    count: int,
    *,
    elevation: float,
    up: Tensor | None,
    start: float = 0.0,
    arc: tuple[float, float] | None = None,
) -> list[Tensor]:
    """Poses world_from_camera (4, 4) from azimuth `start` around, or to and fro in an arc."""
    _check(distance, count, elevation)
    side, ahead, top = _frame(up)
    poses: list[Tensor] = []
    for index in range(count):
        azimuth = start + 2 * math.pi * index / count
        if arc is not None:
            azimuth = arc[0] + 0.5 * arc[1] * math.sin(2 * math.pi * index / count)
        outward = math.cos(azimuth) * side + math.sin(azimuth) * ahead
        right = math.cos(azimuth) * ahead - math.sin(azimuth) * side
        backward = math.cos(elevation) * outward + math.sin(elevation) * top
        pose = torch.eye(4)
        pose[:3, 0] = right
        pose[:3, 1] = torch.linalg.cross(backward, right)
        pose[:3, 2] = backward
        pose[:3, 3] = center.cpu() + distance * backward
        poses.append(pose)
    return poses


def _frame(up: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
    """Right-handed orthonormal frame whose third axis is `up`; x, y, z for +z."""
    top = torch.tensor(_UP) if up is None else up.detach().cpu().float()
    length = float(top.norm())
    if top.shape != (3,) or not math.isfinite(length) or length < _PARALLEL:
        raise InputError(f"orbit: expected an up direction (3,) of finite length, got {up}")
    top = top / length
    # The axis that is least along `up` cannot be parallel to it; +x for +z.
    side = torch.eye(3)[int(top.abs().argmin())]
    side = side - (side @ top) * top
    side = side / side.norm()
    return side, torch.linalg.cross(top, side), top


def _check(distance: float, count: int, elevation: float) -> None:
    if count < 1:
        raise InputError(f"orbit: expected at least one camera, got {count}")
    if not (distance > 0 and math.isfinite(distance)):
        raise InputError(f"orbit: expected a positive distance in world units, got {distance}")
    if not abs(elevation) < math.pi / 2:
        raise InputError(
            "orbit: expected an elevation between -pi/2 and pi/2 radians (straight above there is "
            f"no way up in the picture), got {elevation}"
        )
