"""Pictures of an object with their cameras: a data set that trainers read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from pcore.asset.asset import Asset, Posed
from pcore.capture.load import load_scene
from pcore.data.camera_output import TRANSFORMS, save_transforms
from pcore.data.pictures import png_content, to_bytes
from pcore.data.ply import plain_ply
from pcore.data.whole_file import write_whole
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.render.image import Image
from pcore.training.gaussian_start import mean_colors

_POINTS = "points.ply"
_FAINT = 0.02

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
    (folder / "images").mkdir(exist_ok=True)
    black, files, seen = asset.over((0.0, 0.0, 0.0)), list[Path](), False
    for number, (name, camera) in enumerate(cameras, start=1):
        rgba = straight(black.render(posed, camera).cpu())
        seen |= bool((rgba[..., 3] > _FAINT).any())
        files.append(folder / "images" / f"{name}.png")
        write_whole(files[-1], png_content(rgba), "picture")
        if progress is not None:
            progress(number, len(cameras))
    if not seen:
        raise InputError(
            f"{folder}: nothing is to be seen in any of the {len(cameras)} picture(s) written; do "
            "the cameras look at the object?"
        )
    transforms = folder / TRANSFORMS
    save_transforms(transforms, cameras)
    positions = (asset.points if posed is None else posed.points).detach().cpu().float()
    write_whole(folder / _POINTS, _painted(folder, positions), "points")
    save_transforms(transforms, cameras, keys={"ply_file_path": _POINTS})
    return [transforms, folder / _POINTS, *files]


def straight(image: Image) -> Tensor:
    """Straight colours and opacity (H, W, 4) of a picture over black."""
    alpha = image.alpha.clamp(0, 1).unsqueeze(-1)
    rgb = torch.where(alpha > 0, image.rgb / alpha.clamp_min(1 / 255), 0.0)
    return torch.cat([rgb.clamp(0, 1), alpha], dim=-1)


def _painted(folder: Path, positions: Tensor) -> bytes:
    """A PLY of points in the colours that the pictures show there."""
    colors = to_bytes(mean_colors(positions, load_scene(folder).split("train"))).numpy()
    return plain_ply(positions.numpy(), np.ascontiguousarray(colors), None)
