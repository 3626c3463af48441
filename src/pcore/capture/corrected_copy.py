"""A corrected copy of a capture: straight pictures, masks, crops, only the photos that are good.

It is written in the layout of nerfstudio's `transforms.json`, which pcore and other tools read, and
never into the folder of the capture.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from pcore.capture.transforms_capture import REGION_KEY
from pcore.data.pictures import to_bytes, write_photo
from pcore.data.points import save_points
from pcore.data.scene import Scene, View
from pcore.data.whole_file import replace_file
from pcore.errors import InputError
from pcore.geometry.camera import Camera

_MARGIN = 0.08
"""Room around the object in a crop, as a share of its size."""
_LEAST = 16
_TRACE = 0.05
_POINTS = "sparse_points.ply"
Key = tuple[str, str]
"""Split and name of a view: names alone are unique within a split."""
Part = tuple[int, int, int, int]
"""Left, top, right, bottom, pixels."""


def write_corrected(
    scene: Scene,
    folder: Path,
    *,
    masks: Mapping[Key, Tensor] | None = None,
    leave_out: Collection[Key] = (),
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Write `transforms.json`, `images/` and sparse points: undistorted, with alpha, cut.

    Args:
        scene: whose views are copied, in the size that they were opened in.
        folder: new or empty, outside of the scene's own.
        masks: split and name of a view -> (h, w) uint8 mask in any size, 255 is object; views
            without one are left out. None takes the alpha that views have.
        leave_out: splits and names of views.
        progress: told (pictures written, pictures in all).

    Returns:
        Number of pictures.

    Raises:
        InputError: the folder is the scene's, lies in it, or holds something.
        OSError: a file cannot be written.
    """
    _check_folder(scene, folder)
    chosen = [
        (split, view)
        for split in scene.splits
        for view in scene.split(split)
        if (split, view.name) not in leave_out and (masks is None or (split, view.name) in masks)
    ]
    (folder / "images").mkdir(parents=True, exist_ok=True)
    frames: list[dict[str, Any]] = []
    names: dict[str, list[str]] = {split: [] for split in scene.splits}
    taken: set[str] = set()
    own = [None if masks is None else masks[split, view.name] for split, view in chosen]
    parts = _parts([view for _, view in chosen], own)
    for number, ((split, view), mask, part) in enumerate(zip(chosen, own, parts, strict=True)):
        name = f"images/{view.name if view.name not in taken else f'{split}_{view.name}'}.png"
        taken.add(view.name)
        left, top, right, bottom = part
        kept = _picture(view, mask)[top:bottom, left:right]
        write_photo(folder / name, kept, opaque=mask is None and not view.has_alpha)
        frames.append(_frame(view.camera, part, name))
        names[split].append(name)
        if progress is not None:
            progress(number + 1, len(chosen))
    content = _described(scene, folder, frames, names)
    replace_file(folder / "transforms.json", json.dumps(content, indent=1).encode())
    return len(chosen)


def _described(
    scene: Scene,
    folder: Path,
    frames: Sequence[dict[str, Any]],
    names: Mapping[str, Sequence[str]],
) -> dict[str, Any]:
    """The scene file of such frames, given the pictures of every split; writes the points."""
    content: dict[str, Any] = {
        "camera_model": "PINHOLE",
        "frames": frames,
        **{f"{split}_filenames": files for split, files in names.items() if files},
    }
    if scene.sparse is not None:
        colors = scene.sparse.colors
        paint = None if colors is None else to_bytes(colors)
        save_points(folder / _POINTS, scene.sparse.positions, paint)
        content["ply_file_path"] = _POINTS
    region = scene.region
    if region is not None:
        content[REGION_KEY] = {"center": region.center.tolist(), "radius": region.radius}
    return content


def check_outside(scene: Scene, folder: Path) -> None:
    """Raise InputError where a place to write to lies in one of the scene's own folders.

    These are what was given, or the folder of a file that was; that which the images lie in; and
    those of the training photos.
    """
    given = (scene.folder or scene.root).resolve()
    homes = {given if given.is_dir() else given.parent, scene.root.resolve()}
    # Not of all splits: a test image that is missing keeps nobody from training.
    homes |= {view.image.path.resolve().parent for view in scene.views.get("train", ())}
    home = next((home for home in homes if folder.resolve().is_relative_to(home)), None)
    if home is not None:
        raise InputError(
            f"{folder}: lies in the scene's own folder {home}, which is never written to; choose "
            "another one"
        )


def _check_folder(scene: Scene, folder: Path) -> None:
    check_outside(scene, folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: expected a new or empty folder for the corrected copy")


def _picture(view: View, mask: Tensor | None) -> Tensor:
    rgba = view.rgba()
    if mask is not None:
        size = (view.camera.height, view.camera.width)
        rgba[..., 3] *= F.interpolate(mask[None, None].float() / 255, size, mode="bilinear")[0, 0]
    return rgba


def _parts(views: Sequence[View], masks: Sequence[Tensor | None]) -> list[Part]:
    """What is kept of each picture; one size for pictures of one size, as other tools want it.

    With masks it holds the largest object; without, it is what all pictures show.
    """
    kept: list[Part] = []
    masked = [mask is not None or v.has_alpha for v, mask in zip(views, masks, strict=True)]
    for view, mask, cut in zip(views, masks, masked, strict=True):
        kept.append(_part(view, _picture(view, mask), masked=cut))
    found: list[Part] = []
    for view, cut, (left, top, right, bottom) in zip(views, masked, kept, strict=True):
        alike = [
            part
            for part, other in zip(kept, views, strict=True)
            if (other.camera.width, other.camera.height) == (view.camera.width, view.camera.height)
        ]
        choose = max if cut else min
        width = choose(part[2] - part[0] for part in alike)
        height = choose(part[3] - part[1] for part in alike)
        x = min(max(0, (left + right - width) // 2), view.camera.width - width)
        y = min(max(0, (top + bottom - height) // 2), view.camera.height - height)
        found.append((x, y, x + width, y + height))
    return found


def _part(view: View, rgba: Tensor, *, masked: bool) -> Part:
    """Left, top, right, bottom of what is kept: the object with room, or all that is shown."""
    height, width = rgba.shape[:2]
    valid = view.valid()
    if not masked:
        return (0, 0, width, height) if valid is None else _inner(valid)
    rows, columns = (rgba[..., 3] > _TRACE).nonzero(as_tuple=True)
    if len(rows) == 0:
        return 0, 0, width, height
    left, right = int(columns.min()), int(columns.max()) + 1
    top, bottom = int(rows.min()), int(rows.max()) + 1
    room = round(_MARGIN * max(right - left, bottom - top)) + 2
    spread = max(0, _LEAST - min(right - left, bottom - top))
    room += spread
    return (
        max(0, left - room),
        max(0, top - room),
        min(width, right + room),
        min(height, bottom + room),
    )


def _inner(valid: Tensor) -> Part:
    """The picture without the borders that straightening left empty, side by side cut away."""
    height, width = valid.shape
    left, top, right, bottom = 0, 0, width, height
    while right - left > _LEAST and bottom - top > _LEAST:
        part = valid[top:bottom, left:right]
        if bool(part.all()):
            break
        empty = torch.stack(
            [(~part[:, 0]).sum(), (~part[0]).sum(), (~part[:, -1]).sum(), (~part[-1]).sum()]
        )
        sides = torch.tensor([bottom - top, right - left] * 2)
        worst = int((empty / sides).argmax())
        left, top = left + (worst == 0), top + (worst == 1)
        right, bottom = right - (worst == 2), bottom - (worst == 3)
    return left, top, right, bottom


def _frame(camera: Camera, part: Part, name: str) -> dict[str, Any]:
    left, top, right, bottom = part
    return {
        "file_path": name,
        "transform_matrix": camera.world_from_camera.tolist(),
        "fl_x": float(camera.fx),
        "fl_y": float(camera.fy),
        "cx": float(camera.cx) - left,
        "cy": float(camera.cy) - top,
        "w": right - left,
        "h": bottom - top,
    }
