"""How well the light is estimated, apart from any model: colours of spots on true meshes.

    python -m benchmarks.light_error SCENE [SCENE ...] [--factor 1] [--points 6000]

Spots all over the canonical mesh get their colours from the training photos and their normals from
the mesh. The light is estimated from them, and their colours in every deformed state are compared
with those in its true pictures: root mean square over spots and channels of stored colours, with
the light baked in and with the light standing still. "canonical" is what views of one state differ
by; nothing gets below that. SCENE is a folder with meshes.npz, such as benchmarks/lit_scenes.py
makes: choose on those, the states of the test data are for reports.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from baked_light import face_frames
from reprojected_truth import look_up
from torch import Tensor
from torch.nn import functional as F

from pcore.capture.load import load_scene
from pcore.data.scene import View
from pcore.evaluation.mesh_depth import mesh_depth
from pcore.evaluation.states import CANONICAL, open_states
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.relight.estimate import fit_light
from pcore.render.surfel_fit import Observed
from pcore.sample.sample_render import MeshCaster, sample_surface

_FACING = 0.3
_TOLERANCE = 0.015
_SOLID = 0.99
_SMOOTH = 0.94
"""Cosine between a face and the mean around a vertex up to which a surface counts as smooth."""


def main() -> None:
    """Print a table per scene."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--factor", type=int, default=1)
    parser.add_argument("--points", type=int, default=6000)
    wish = parser.parse_args()
    for root in wish.scenes:
        table(root, wish.factor, wish.points)


def table(root: Path, factor: int, count: int) -> None:
    """Print what every state is off by."""
    places = open_states(root, factor=factor)
    if places.truth is None:
        raise SystemExit(f"{root}: no meshes.npz")
    truth, faces = places.truth, outwards(places.truth.canonical, places.truth.faces)
    face, weights = sample_surface(MeshCaster(truth.canonical, faces), 3 * count, 0)
    spots = Spots(faces, face, weights)
    points, normals = spots.of(truth.canonical)
    photos = load_scene(root, factor=factor).split("train")
    colors, seen = colours(points, normals, photos, truth.canonical, faces)
    kept = (seen >= 2).nonzero()[:count, 0]
    spots, points, normals = spots.some(kept), points[kept], normals[kept]
    heights = torch.zeros(len(points))
    observed = Observed(normals=normals, colors=colors[kept], attention=seen[kept], heights=heights)
    relighting = fit_light(observed, points)
    cloud = PointCloud(
        positions=points, features=torch.zeros(len(points), 1), influence=torch.ones(len(points))
    )
    surfels = observed.surfels(cloud)
    nearness = relighting.light.mean_nearness
    print(
        f"| {root.name}, lamps at 1 / {nearness:.3f} | baked in | standing still |\n|---|---|---|"
    )
    for state in places.select(["all"]):
        name = None if state.name == CANONICAL else state.name
        vertices = truth.vertices(name)
        there, facing = spots.of(vertices)
        views = [shot.view for shot in state.shots]
        expected, visible = colours(there, facing, views, vertices, faces)
        gains = torch.ones(len(points))
        if name is not None:
            maps, places = spots.local_maps(truth.canonical, vertices), there.float()
            posed = PosedCloud(
                cloud=cloud,
                positions=places,
                local_maps=maps,
                surfels=surfels.moved(places, maps),
            )
            gains = relighting.gains(posed)
        lit = (visible > 0).nonzero()[:, 0]
        errors = (
            (found.clamp(0, 1)[lit] - expected[lit]).square().mean().sqrt()
            for found in (colors[kept], colors[kept] * gains[:, None])
        )
        print(f"| {state.name} | {' | '.join(f'{float(one):.4f}' for one in errors)} |", flush=True)


def outwards(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces whose corners go round counterclockwise seen from outside."""
    corners = vertices[faces]
    volume = np.einsum("fc,fc->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    return faces if volume > 0 else faces[:, ::-1].copy()


class Spots:
    """Spots on a mesh, wherever its vertices are."""

    def __init__(self, faces: np.ndarray, face: np.ndarray, weights: np.ndarray) -> None:
        self._faces, self._face, self._weights = faces, face, weights

    def some(self, index: Tensor) -> Spots:
        """Return those of some indices."""
        kept = index.numpy()
        return Spots(self._faces, self._face[kept], self._weights[kept])

    def of(self, vertices: np.ndarray) -> tuple[Tensor, Tensor]:
        """Places and unit normals (N, 3) on a mesh with such vertices (V, 3)."""
        corners = vertices[self._faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        _, same = np.unique(np.round(vertices, 5), axis=0, return_inverse=True)
        sums = np.zeros((same.max() + 1, 3))
        for corner in range(3):
            np.add.at(sums, same.ravel()[self._faces[:, corner]], across)
        around = F.normalize(torch.from_numpy(sums), dim=1).numpy()[same.ravel()]
        mine = self._faces[self._face]
        smooth = np.einsum("ni,nic->nc", self._weights, around[mine])
        flat = F.normalize(torch.from_numpy(across[self._face]), dim=1)
        round_ = F.normalize(torch.from_numpy(smooth), dim=1)
        alike = (flat * round_).sum(dim=1, keepdim=True) > _SMOOTH
        places = np.einsum("ni,nic->nc", self._weights, vertices[mine])
        return torch.from_numpy(places).float(), torch.where(alike, round_, flat).float()

    def local_maps(self, before: np.ndarray, after: np.ndarray) -> LocalMaps:
        """Maps of the triangles, from one mesh to another."""
        mine = self._faces[self._face]
        back = face_frames(before[mine]) @ np.linalg.pinv(face_frames(after[mine]))
        return LocalMaps(to_rest=torch.from_numpy(back).float())


def colours(
    points: Tensor, normals: Tensor, views: Sequence[View], vertices: np.ndarray, faces: np.ndarray
) -> tuple[Tensor, Tensor]:
    """Mean colours (N, 3) of spots over the views that see them well, and how many do (N,)."""
    sums, counts = torch.zeros(len(points), 3), torch.zeros(len(points))
    for view in views:
        found = look_up(points, view.camera, view.rgba(), mesh_depth(vertices, faces, view.camera))
        towards = F.normalize(view.camera.center - points, dim=1)
        good = (towards * normals).sum(dim=1) > _FACING
        good &= (found.behind.abs() < _TOLERANCE) & (found.alpha > _SOLID)
        sums[good] += found.colours[good]
        counts[good] += 1
    return sums / counts.clamp_min(1)[:, None], counts


if __name__ == "__main__":
    main()
