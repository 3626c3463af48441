"""Pictures of an object with their cameras: a data set that trainers read."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from pcore.asset.asset import Asset, Posed
from pcore.capture.load import load_scene
from pcore.data.blender import transforms_path
from pcore.data.camera_output import TRANSFORMS, save_transforms
from pcore.data.pictures import png_content, to_bytes
from pcore.data.points import save_points
from pcore.data.whole_file import write_whole
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.render.image import Image
from pcore.training.gaussian_start import mean_colors

_POINTS = "points.ply"
_FAINT = 0.02
_TEST_EVERY, _LEAST_TO_TEST = 8, 3

Named = Sequence[tuple[str, Camera]]


def save_picture_set(
    folder: Path,
    asset: Asset,
    posed: Posed | None,
    cameras: Named,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Write pictures, transforms.json and points, as nerfstudio and `load_scene` read them.

    Pictures are RGBA with straight alpha, in `images`; poses are those of the world of the object.

    Args:
        folder: that exists.
        asset: the object.
        posed: from `Asset.pose`; None is the object at rest.
        cameras: by name.
        progress: told (pictures taken, pictures in all).

    Raises:
        InputError: nothing is to be seen, or a place that is not writable.
    """
    shots = [_Shot(file=f"images/{name}.png", camera=c, posed=posed) for name, c in cameras]
    files = _take(folder, asset, shots, progress)
    transforms = folder / TRANSFORMS
    save_transforms(transforms, cameras)
    positions = (asset.points if posed is None else posed.points).detach().cpu().float()
    # In the colours that the pictures show there.
    colors = to_bytes(mean_colors(positions, load_scene(folder).split("train")))
    save_points(folder / _POINTS, positions, colors)
    save_transforms(transforms, cameras, keys={"ply_file_path": _POINTS})
    return [transforms, folder / _POINTS, *files]


def save_moving_set(
    folder: Path,
    asset: Asset,
    moments: Sequence[tuple[float, Posed]],
    cameras: Named,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Write pictures of a moving object as D-NeRF's data sets are, which `load_scene` reads, too.

    Every camera takes a picture at every time. Of three cameras or more every eighth is in the test
    set and in no other.

    Args:
        folder: that exists.
        asset: the object.
        moments: times of the edit file, and the object then.
        cameras: by name.
        progress: told (pictures taken, pictures in all).

    Returns:
        transforms_train.json, and transforms_test.json where there is a test set.

    Raises:
        InputError: nothing is to be seen, or a place that is not writable.
    """
    tests = len(cameras) >= _LEAST_TO_TEST
    sets = {"train": [one for k, one in enumerate(cameras) if not tests or k % _TEST_EVERY]}
    if tests:
        sets["test"] = [*cameras[::_TEST_EVERY]]
    written, shots = list[Path](), list[_Shot]()
    for split, chosen in sets.items():
        named, files, times = list[tuple[str, Camera]](), dict[str, str](), list[float]()
        for frame, (time, posed) in zip(frame_names(len(moments)), moments, strict=True):
            for name, camera in chosen:
                one = f"{frame}_{name}"
                named.append((one, camera))
                files[one] = f"{split}/{one}"  # Readers of this form add the ending.
                times.append(time)
                shots.append(_Shot(file=f"{files[one]}.png", camera=camera, posed=posed))
        written.append(transforms_path(folder, split))
        save_transforms(written[-1], named, files=files, keys=_angle(chosen), times=times)
    _take(folder, asset, shots, progress)
    return written


def _angle(cameras: Named) -> dict[str, float]:
    """The one number of a lens that D-NeRF's form has, where all cameras have one lens."""
    angles = {2 * math.atan(0.5 * camera.width / float(camera.fx)) for _, camera in cameras}
    return {"camera_angle_x": angles.pop()} if len(angles) == 1 else {}


def frame_names(count: int) -> list[str]:
    """Names of frames in their order, for files and folders."""
    digits = max(3, len(str(count - 1)))
    return [f"frame_{k:0{digits}}" for k in range(count)]


@dataclass(frozen=True, kw_only=True)
class _Shot:
    """A picture to take: its file within the folder, camera, and the object."""

    file: str
    camera: Camera
    posed: Posed | None


def _take(
    folder: Path,
    asset: Asset,
    shots: Sequence[_Shot],
    progress: Callable[[int, int], None] | None,
) -> list[Path]:
    """Write pictures of the object over nothing; InputError when none shows it."""
    black, files, seen = asset.over((0.0, 0.0, 0.0)), list[Path](), False
    for number, shot in enumerate(shots, start=1):
        rgba = straight(black.render(shot.posed, shot.camera).cpu())
        seen |= bool((rgba[..., 3] > _FAINT).any())
        files.append(folder / shot.file)
        files[-1].parent.mkdir(exist_ok=True)
        write_whole(files[-1], png_content(rgba), "picture")
        if progress is not None:
            progress(number, len(shots))
    if not seen:
        raise InputError(
            f"{folder}: nothing is to be seen in any of the {len(shots)} picture(s) written; do "
            "the cameras look at the object?"
        )
    return files


def straight(image: Image) -> Tensor:
    """Straight colours and opacity (H, W, 4) of a picture over black."""
    alpha = image.alpha.clamp(0, 1).unsqueeze(-1)
    rgb = torch.where(alpha > 0, image.rgb / alpha.clamp_min(1 / 255), 0.0)
    return torch.cat([rgb.clamp(0, 1), alpha], dim=-1)
