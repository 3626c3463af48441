"""Sparse points for poses that came without: matched features, triangulated by the poses.

They are where training can start, and they check the poses: features that photos share lie on the
lines that the poses predict, or the poses are wrong.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import shutil
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pcore.capture.colmap import raw_points
from pcore.capture.colmap_child import Patience, Tell, run_child
from pcore.capture.colmap_model import kind_of, read_model
from pcore.capture.scene_masks import ordered_views
from pcore.capture.structure import cache_folder, files_key
from pcore.data.pictures import write_mask, write_png
from pcore.data.scene import Scene, View
from pcore.data.sparse import Sightings, SparsePoints
from pcore.errors import DependencyError, SceneError

CHILD = (sys.executable, "-m", "pcore.capture.triangulation_child")
_NEIGHBOURS = 20
"""Photos that each is matched with: the nearest that look the same way."""
_SAME_WAY = 0.5
"""Least cosine between the viewing axes of photos that are matched."""
_SIDE = 1600
"""Longer side, pixels, up to which pictures are used as fine as the files have them."""
WRONG = 1.0
"""Distances in pixels that right poses stay well below: 0.2 in those that were tried."""
_LEAST = 15
"""Fewer matches of two photos are chance."""
_AGREEMENT, _MODEL = "agreement.npy", "model"


@dataclass(frozen=True, kw_only=True)
class PoseAgreement:
    """How far matched features lie from the lines that the poses predict.

    Attributes:
        median: pixels of the pictures that were matched, over pairs of photos.
        of_views: the same of the pairs of each of `ordered_views`; NaN where it has none.
        pairs: of photos that show common features.
        points: that were triangulated.
    """

    median: float
    of_views: tuple[float, ...]
    pairs: int
    points: int

    def doubtful(self) -> tuple[int, ...]:
        """Numbers of the views with large distances."""
        limit = max(WRONG, 3 * self.median)
        return tuple(i for i, off in enumerate(self.of_views) if off > limit)


@dataclass(frozen=True, kw_only=True, eq=False)
class Triangulated:
    """A scene with points, and what they say about its poses.

    Attributes:
        scene: with `sparse`; as it was where no point is found.
        agreement: of the poses; None where no two photos show common features.
    """

    scene: Scene
    agreement: PoseAgreement | None


def triangulated(scene: Scene, tell: Tell, patience: Patience | None = None) -> Triangulated:
    """Match features of a scene's photos and triangulate them by the poses; kept in the cache.

    Args:
        scene: posed photos; masks and pixels that are not valid hide features.
        tell: called with lines of progress.
        patience: how long it may take.

    Returns:
        The scene with its points, whose sightings are of all views of a capture and of the training
        views of a rendered scene.

    Raises:
        SceneError: the child hung or crashed, or images are damaged.
        DependencyError: pycolmap (extra `colmap`) is not installed.
    """
    views = ordered_views(scene)
    wish = _wish(views)
    said = hashlib.sha256(json.dumps(wish).encode()).hexdigest()[:24]
    files = [view.image.path for view in views]
    files += [view.image.mask for view in views if view.image.mask is not None]
    place = cache_folder() / f"{files_key(files)}-{said}"
    if not place.is_dir():
        _make(place, views, wish, tell, patience or Patience(), str(scene.root))
    sparse = _read(place, views)
    found = np.load(place / _AGREEMENT, allow_pickle=False)
    return Triangulated(
        scene=scene if sparse is None else replace(scene, sparse=sparse),
        agreement=_agreement(found, views, 0 if sparse is None else len(sparse)),
    )


def _fine(view: View) -> View:
    """The view in the finest size that is of use and that divides as its own does."""
    factor = view.image.factor
    longest = factor * max(view.camera.width, view.camera.height)
    divisors = [n for n in range(1, factor + 1) if factor % n == 0]
    chosen = next((n for n in divisors if longest / n <= _SIDE), factor)
    times = factor // chosen
    camera = view.camera.resized(times * view.camera.width, times * view.camera.height)
    return replace(view, camera=camera, image=replace(view.image, factor=chosen, cut=None))


def _wish(views: Sequence[View]) -> dict[str, Any]:
    """What the child is told beside the folders."""
    cameras: list[dict[str, Any]] = []
    flip = torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64)
    for number, view in enumerate(views):
        camera = _fine(view).camera
        rotation = flip[:, None] * camera.world_from_camera[:3, :3].double().T
        shift = -rotation @ camera.center.double()
        cameras.append(
            {
                "name": f"{number:05d}.png",
                "width": camera.width,
                "height": camera.height,
                "fx": camera.focal[0],
                "fy": camera.focal[1],
                "cx": float(camera.cx),
                "cy": float(camera.cy),
                "camera_from_world": torch.cat([rotation, shift[:, None]], dim=1).tolist(),
            }
        )
    pairs = [[cameras[i]["name"], cameras[j]["name"]] for i, j in _pairs(views)]
    return {"cameras": cameras, "pairs": pairs}


def _pairs(views: Sequence[View]) -> list[tuple[int, int]]:
    """Numbers of views that are matched, each pair once."""
    centers = torch.stack([view.camera.center for view in views]).double()
    axes = torch.stack([view.camera.world_from_camera[:3, 2] for view in views]).double()
    distances = torch.cdist(centers, centers)
    distances[axes @ axes.T < _SAME_WAY] = torch.inf
    distances.fill_diagonal_(torch.inf)
    near = distances.argsort(dim=1)[:, :_NEIGHBOURS]
    return sorted(
        {
            (min(i, j), max(i, j))
            for i, row in enumerate(near.tolist())
            for j in row
            if torch.isfinite(distances[i, j])
        }
    )


def _make(
    place: Path,
    views: Sequence[View],
    wish: dict[str, Any],
    tell: Tell,
    patience: Patience,
    where: str,
) -> None:
    """Make model and agreement in a folder beside their place, and move them there when whole."""
    if importlib.util.find_spec("pycolmap") is None:
        raise DependencyError(
            "points by the poses need pycolmap, which is not installed: "
            "`pip install 'pcore-edit[colmap]'`"
        )
    place.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=place.parent, prefix="unfinished-") as made:
        work = Path(made)
        folders = {name: work / name for name in ("images", "masks", _MODEL)}
        for folder in folders.values():
            folder.mkdir()
        tell(f"straightening {len(views)} photos")
        for view, camera in zip(views, wish["cameras"], strict=True):
            rgba, valid = _fine(view).rgba(), _fine(view).valid()
            shown = rgba[..., 3] if valid is None else rgba[..., 3] * valid
            write_png(folders["images"] / camera["name"], rgba[..., :3])
            write_mask(folders["masks"] / f"{camera['name']}.png", (shown > 0.5).float())
        told = wish | {
            "images": str(folders["images"]),
            "masks": str(folders["masks"]),
            "output": str(folders[_MODEL]),
            "agreement": str(work / _AGREEMENT),
        }
        (work / "wish.json").write_text(json.dumps(told))
        run_child([*CHILD, str(work / "wish.json")], tell, patience, where, "points")
        for name in ("images", "masks"):
            shutil.rmtree(folders[name])
        (folders[_MODEL] / "database.db").unlink(missing_ok=True)
        shutil.copytree(work, place)


def _read(place: Path, views: Sequence[View]) -> SparsePoints | None:
    """The points with their sightings in the pixels of the scene's views."""
    folder = place / _MODEL
    if kind_of(folder) is None:
        raise SceneError(f"{place}: expected a model of COLMAP; remove this folder")
    model = read_model(folder)
    raw = raw_points(model)
    if raw is None or raw.points is None or raw.photos is None or raw.places is None:
        return None
    numbers = torch.tensor([int(Path(image.name).stem) for image in model.images])
    which = numbers[raw.photos]
    return SparsePoints(
        positions=raw.positions.float(),
        colors=raw.colors,
        errors=raw.errors,
        seen_by=raw.seen_by,
        sightings=Sightings(
            names=tuple(view.name for view in views),
            points=raw.points,
            views=which,
            places=(raw.places / _times(views)[which, None]).float(),
        ),
    )


def _times(views: Sequence[View]) -> Tensor:
    """(V,) how many times finer than the views the pictures are that are looked at."""
    return torch.tensor([view.image.factor / _fine(view).image.factor for view in views])


def _agreement(
    rows: np.ndarray[tuple[int, ...], np.dtype[np.float64]], views: Sequence[View], points: int
) -> PoseAgreement | None:
    rows = rows[rows[:, 2] >= _LEAST]
    if not len(rows):
        return None
    off = [rows[(rows[:, :2] == number).any(axis=1), 3] for number in range(len(views))]
    return PoseAgreement(
        median=float(np.median(rows[:, 3])),
        of_views=tuple(float(np.median(one)) if len(one) else float("nan") for one in off),
        pairs=len(rows),
        points=points,
    )
