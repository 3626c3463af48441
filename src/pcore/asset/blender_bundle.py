"""A folder that Blender's add-on reads: points, anchors, cage, proxy and cameras of an object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.meshing import Meshing, Progress, mesh_of
from pcore.asset.painted_points import painted_points
from pcore.asset.standing import standing_of
from pcore.data.camera_output import save_transforms
from pcore.data.mesh_output import save_mesh
from pcore.data.points import save_painted
from pcore.data.whole_file import save_json
from pcore.deform.cage import Cage
from pcore.editing.autosave import fingerprint
from pcore.errors import InputError
from pcore.files.run_record import relative
from pcore.geometry.camera import Camera
from pcore.geometry.farthest_points import ANCHORS, farthest_points
from pcore.geometry.neighbours import nearest
from pcore.geometry.point_cloud import size_of
from pcore.geometry.surface_mesh import SurfaceMesh, parts_of
from pcore.sample.surface_nets import surface_nets

VERSION = 1
BUNDLE_FILE = "bundle.json"
POINTS_FILE, ANCHORS_FILE, CAMERAS_FILE = "points.ply", "anchors.json", "cameras.json"
CAGE_FILE, PROXY_FILE = "cage.ply", "proxy.ply"
_CAGE_CELLS = 10
"""Cells along the longest side of the points: some hundreds of vertices, for hands to move."""
_WIDENINGS = 16
_GREY = 0.5


def save_bundle(
    folder: Path,
    asset: Asset,
    views: Sequence[tuple[str, Camera]],
    *,
    lookers: Sequence[Camera] | None = None,
    fps: int = 24,
    resolution: int = 100,
    progress: Progress | None = None,
) -> None:
    """Write what the add-on imports; `bundle.json` comes last and names the rest.

    Args:
        folder: where to; it exists.
        asset: the object, at rest.
        views: cameras by name for Blender.
        lookers: cameras that look at the surface and the colours; None looks from all around.
        fps: frames per second that keyframes from Blender are counted in.
        resolution: voxels of the proxy along its longest side.
        progress: told (pictures taken, pictures in all) of the colours, then of the proxy.

    Raises:
        InputError: nothing solid is to be seen, points all in one place, or a folder that cannot
            be written to.
        DependencyError: scikit-image is not installed.
    """
    points = asset.points.float()
    standing = standing_of(asset)
    body = points[standing.body(points)]
    cage = cage_around(body)
    painted = painted_points(asset, lookers, progress=progress)
    proxy = mesh_of(asset, lookers, Meshing(resolution=resolution), progress=progress).mesh
    save_painted(folder / POINTS_FILE, points, painted.colors, painted.normals, painted.confidence)
    save_mesh(folder / PROXY_FILE, proxy)
    grey = torch.full_like(cage.vertices, _GREY)
    save_mesh(
        folder / CAGE_FILE, SurfaceMesh(vertices=cage.vertices, faces=cage.faces, colors=grey)
    )
    anchors = body[farthest_points(body, min(ANCHORS, len(body)))]
    save_json(folder / ANCHORS_FILE, {"near": anchors.tolist()}, "bundle")
    save_transforms(folder / CAMERAS_FILE, views)
    about = _about(folder, asset, points, fps) | {
        "size": size_of(body),
        "axes": standing.axes.tolist(),
    }
    save_json(folder / BUNDLE_FILE, about, "bundle")


def cage_around(points: Tensor) -> Cage:
    """Make a coarse closed mesh that holds points (N, 3), world units.

    It is the surface at an even distance from the points, without what it encloses; the distance
    grows until the mesh is sound and holds them all.

    Raises:
        InputError: points all in one place, or no such mesh is found.
    """
    places = points.detach().cpu().double().numpy()
    longest = float(np.ptp(places, axis=0).max())
    if not longest > 0:
        raise InputError("cage: expected points that extend in space, got all in one place")
    cell = longest / _CAGE_CELLS
    for widening in range(_WIDENINGS):
        margin = cell * 1.2 * 1.15**widening
        lower, upper = (end(axis=0) for end in (places.min, places.max))
        slack = margin + 2 * cell
        vertices, faces = surface_nets(
            _Around(points=torch.from_numpy(places), margin=margin),
            lower - slack,
            upper + slack,
            cell,
        )
        outer_vertices, outer_faces = _outer_shells(vertices, faces)
        edges = torch.stack([outer_faces, outer_faces.roll(-1, dims=1)], dim=-1).reshape(-1, 2)
        if len(torch.unique(edges, dim=0)) < len(edges):
            # Two sheets touch along an edge; farther out they have merged.
            continue
        cage = Cage(vertices=outer_vertices, faces=outer_faces)
        if bool(cage.holds(points).all()):
            return cage
    raise InputError(
        "cage: found no closed mesh around all points; are some of them strays far from the object?"
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Around:
    """Distance of places (M, 3) from points (N, 3), less a margin."""

    points: Tensor
    margin: float

    def __call__(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        _, distance = nearest(self.points, torch.from_numpy(places), 1)
        return distance[:, 0].numpy() - self.margin


def _outer_shells(vertices: Any, faces: Any) -> tuple[Tensor, Tensor]:
    """Parts of a closed mesh that enclose volume; walls of cavities within are left out."""
    corners = faces.astype(np.int64)
    count, part = parts_of(len(vertices), corners)
    first, second, third = (vertices[corners[:, k]] for k in range(3))
    volumes = np.zeros(count)
    np.add.at(volumes, part[corners[:, 0]], (first * np.cross(second, third)).sum(axis=1))
    kept = corners[volumes[part[corners[:, 0]]] > 0]
    used, numbers = np.unique(kept, return_inverse=True)
    # Rounded as the file will have it, so that what is checked is what is written.
    rounded = torch.from_numpy(vertices[used].astype(np.float32)).double()
    return rounded, torch.from_numpy(numbers.reshape(-1, 3))


def _about(folder: Path, asset: Asset, points: Tensor, fps: int) -> dict[str, Any]:
    run = asset.record.path
    return {
        "version": VERSION,
        "run": "" if run is None else run.resolve().name,
        "run_folder": None if run is None else relative(run, folder),
        "points_hash": fingerprint(points),
        "point_count": len(points),
        "scale": 1.0,
        "fps": fps,
        "files": {
            "points": POINTS_FILE,
            "anchors": ANCHORS_FILE,
            "cage": CAGE_FILE,
            "proxy": PROXY_FILE,
            "cameras": CAMERAS_FILE,
        },
    }
