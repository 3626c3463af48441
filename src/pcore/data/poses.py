"""What the poses of a scene say about it: where its object is, and whether that can be true.

Poses are looked at in double precision, as files have them, before they are rounded to float32.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from pcore.errors import SceneError
from pcore.geometry.camera import Camera

# Below this, the viewing axes are parallel for all that float32 poses can tell.
_PARALLEL = 1e-4
_HALF_STEP = 2.0**-24
"""Largest rounding of float32, as a share of the number."""
_REFUSED, _TOLD = 6e-5, 6e-6
"""Rounding of places as a share of the scene: a twentieth and a two-hundredth of a pixel of
pictures 800 pixels wide. Photos 50 pixels wide, 120 steps: 21.8 dB at the origin, 21.5, 20.9 and
21.1 dB moved away by 100, 1,000 and 10,000 times the cameras' distance, 18.2 dB in UTM."""
_EXACT = 1e-6
"""Rounding of places, as a share of the scene, above which poses are kept as files have them."""
_ONE_PLACE, _NEAR = 1e-7, 100.0
"""Cameras closer together than that share of their coordinates, or that cannot be told apart and
are nearer to the origin than that, stand at one place; all others are far away."""
_OPENCV = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))


def closest_to_axes(poses: Tensor) -> Tensor | None:
    """Point (3,) float64 that viewing axes come closest to (least squares).

    None where they are parallel, or too large to be said.

    Args:
        poses: (N, 4, 4) world_from_camera.
    """
    poses = poses.double()
    axis = -poses[:, :3, 2]
    # Sum over views of |(1 - a a^T) (x - o)|^2: a 3 x 3 linear system.
    across = torch.eye(3, dtype=torch.float64) - axis[:, :, None] * axis[:, None, :]
    system = across.mean(dim=0)
    if not bool(torch.isfinite(system).all()):
        return None
    if float(torch.linalg.eigvalsh(system)[0]) < _PARALLEL:
        return None
    right = (across @ poses[:, :3, 3:]).mean(dim=0)[:, 0]
    return torch.linalg.solve(system, right)


def are_far(poses: Sequence[Tensor]) -> bool:
    """Whether cameras stand so far from the origin that single precision rounds their places.

    Args:
        poses: (4, 4) float64 world_from_camera, as in the file; those with NaN do not count.
    """
    known = [pose for pose in poses if bool(torch.isfinite(pose).all())]
    point = closest_to_axes(torch.stack(known)) if known else None
    if point is None:
        return False
    scale, rounding = _scale_and_rounding(torch.stack(known), point)
    return rounding > _EXACT * scale


def _scale_and_rounding(poses: Tensor, point: Tensor) -> tuple[float, float]:
    """How large a scene is by its cameras, and how much single precision rounds their places."""
    centers = poses[:, :3, 3]
    scale = max(
        float((centers - place).norm(dim=-1).mean()) for place in (centers.mean(dim=0), point)
    )
    return scale, float(centers.abs().max()) * _HALF_STEP


def seen_radius(camera: Camera, pose: Tensor, point: Tensor) -> float:
    """Radius of the largest sphere about a point inside a camera's view; negative if none.

    Args:
        camera: for its image size and lens.
        pose: (4, 4) world_from_camera in any precision.
        point: (3,) of the same precision.
    """
    x, y, z = ((point - pose[:3, 3]) @ pose[:3, :3]).tolist()
    depth = -z
    distances = [depth]
    for offset, focal, size, shift in (
        (x, camera.fx, camera.width, camera.cx),
        (-y, camera.fy, camera.height, camera.cy),
    ):
        for slope, side in ((-shift / focal, 1.0), ((size - shift) / focal, -1.0)):
            # Distance to the plane through the camera and one border of the image.
            distances.append(side * (offset - slope * depth) / (1.0 + slope * slope) ** 0.5)
    return min(distances)


def check_poses(poses: Tensor, cameras: Sequence[Camera], names: Sequence[str], where: str) -> str:
    """Refuse poses that no photos of one object can have; return a note about odd ones, or "".

    Args:
        poses: (N, 4, 4) float64 world_from_camera, as in the file.
        cameras: N, for image size and lens.
        names: of the N views.
        where: the file, for the message.

    Raises:
        SceneError: all cameras at one place, a place that single precision cannot hold, or most
            of them looking away from what another reading of the matrices has them all look at.
    """
    point = closest_to_axes(poses)
    if point is None:
        # Others with parallel axes are refused where the object's place is asked for.
        better = _better_reading(poses, cameras)
        if better:
            raise SceneError(
                f"{where}: the viewing axes of all {len(names)} views are parallel; check that "
                f"poses are camera-to-world, OpenGL axes{better}"
            )
        return ""
    far = _check_precision(poses, cameras, point, where)
    seen = _seen(poses, cameras, point)
    away = [name for name, sees in zip(names, seen, strict=True) if not sees]
    if not away:
        return far
    if 2 * len(away) > len(names):
        better = _better_reading(poses, cameras)
        if better:
            raise SceneError(_sees_nothing(where, point, len(away), len(names)) + better)
    some = ", ".join(away[:5]) + ", ..." * (len(away) > 5)
    note = (
        f"{len(away)} of {len(names)} views do not see the point {_rounded(point)} that the "
        f"viewing axes come closest to ({some}); check that their poses are camera-to-world, "
        "OpenGL axes"
    )
    return f"{note}; {far}" if far else note


def _check_precision(poses: Tensor, cameras: Sequence[Camera], point: Tensor, where: str) -> str:
    """Refuse cameras at one place, or too far from the origin; a note where it gets coarse."""
    middle, farthest = poses[:, :3, 3].mean(dim=0), float(poses[:, :3, 3].abs().max())
    scale, rounding = _scale_and_rounding(poses, point)
    if rounding <= _TOLD * scale:
        return ""
    coarse = rounding > _REFUSED * scale
    if scale <= _ONE_PLACE * farthest or (coarse and farthest <= _NEAR):
        raise SceneError(
            f"{where}: no view sees the point {_rounded(middle)} that the viewing axes come closest"
            f" to: all {len(poses)} cameras stand at it, within {scale:.2g}; check that poses are "
            f"camera-to-world, OpenGL axes{_better_reading(poses, cameras)}"
        )
    offset = [round(value) for value in middle.tolist()]
    what = (
        f"the cameras stand about {offset}, {scale:.2g} from the object; single precision rounds "
        f"places there by up to {rounding:.2g}"
    )
    mend = (
        f"subtract {offset} from the last column of every 'transform_matrix' (first three rows), "
        "in all splits and states alike, and from points and edits that you give; add it to what "
        "pcore exports"
    )
    if coarse:
        raise SceneError(f"{where}: expected a scene near the origin, but {what}; {mend}")
    return f"{what}; to lose nothing, {mend}"


def _seen(poses: Tensor, cameras: Sequence[Camera], point: Tensor) -> list[bool]:
    return [
        seen_radius(camera, pose, point) > 0
        for camera, pose in zip(cameras, poses.double(), strict=True)
    ]


def _better_reading(poses: Tensor, cameras: Sequence[Camera]) -> str:
    """Say as what else the matrices make sense: all views then look at one point."""
    inverse = torch.linalg.inv(poses)
    readings = {
        "world-to-camera": inverse,
        "camera-to-world with OpenCV axes (x right, y down, looking along z)": poses @ _OPENCV,
        "world-to-camera with OpenCV axes (x right, y down, looking along z)": inverse @ _OPENCV,
    }
    for name, read in readings.items():
        point = closest_to_axes(read)
        if point is None:
            continue
        distance = (read[:, :3, 3] - point).norm(dim=-1).mean()
        sound = float(read[:, :3, 3].abs().max()) * _HALF_STEP <= _REFUSED * float(distance)
        if sound and all(_seen(read, cameras, point)):
            return f". Read as {name}, all {len(poses)} of them look at one point: convert them"
    return ""


def _sees_nothing(where: str, point: Tensor, away: int, count: int) -> str:
    who = "no view sees" if away == count else f"only {count - away} of {count} views see"
    return (
        f"{where}: {who} the point {_rounded(point)} that the viewing axes come closest to; check "
        "that poses are camera-to-world, OpenGL axes"
    )


def _rounded(point: Tensor) -> list[float]:
    return [float(f"{value:.6g}") for value in point.tolist()]
