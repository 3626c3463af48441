"""Ground truth for deformations that are NOT reported, made from canonical training photos.

The scenes of shared/data/deformed come with the mesh. A pixel of a deformed view is traced to the
deformed mesh, carried back to the canonical surface, and looked up in the training photo that sees
that spot from the most similar direction. Fine-tuning's constants are chosen on such pictures, so
that the reported states stay unseen.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from pcore.data.images import area_downscale
from pcore.data.scene import Scene, View
from pcore.deform.base import Deformation
from pcore.evaluation.mesh_depth import mesh_depth
from pcore.geometry.camera import Camera
from pcore.sample.sample_render import MeshCaster

_SUPERSAMPLING = 2
_DEPTH_TOLERANCE = 0.02


@dataclass(frozen=True, kw_only=True)
class TruthView:
    """A picture of a deformed state: camera, RGBA (H, W, 4) and the part that no photo shows."""

    camera: Camera
    rgba: Tensor
    unseen: float


@dataclass(frozen=True, kw_only=True)
class LookedUp:
    """What a photo shows where points lie: colours (M, 3), opacity and distance behind it (M,)."""

    colours: Tensor
    alpha: Tensor
    behind: Tensor


def look_up(points: Tensor, camera: Camera, photo: Tensor, depth: Tensor) -> LookedUp:
    """Look points (M, 3) up in a photo (H, W, 4) whose true depth (H, W) is known."""
    across, down, z = camera.project(points)
    x, y = across - 0.5, down - 0.5
    column = x.round().long().clamp(0, camera.width - 1)
    row = y.round().long().clamp(0, camera.height - 1)
    grid = torch.stack([(2 * x + 1) / camera.width - 1, (2 * y + 1) / camera.height - 1], dim=-1)
    image = photo[..., :3].permute(2, 0, 1)[None]
    found = torch.nn.functional.grid_sample(image, grid[None, None], align_corners=False)
    return LookedUp(
        colours=found[0, :, 0].T, alpha=photo[row, column, 3], behind=z - depth[row, column]
    )


class PhotoSurface:
    """The canonical surface with the training photos projected on it."""

    def __init__(self, scene: Scene, meshes: Path) -> None:
        with np.load(meshes) as data:
            self.vertices = data["canonical"].astype(np.float64)
            self.faces = data["faces"]
        self.views: tuple[View, ...] = scene.split("train")
        self.depths = [mesh_depth(self.vertices, self.faces, v.camera) for v in self.views]
        self.photos = [v.rgba() for v in self.views]

    def colours(self, points: Tensor, incoming: Tensor) -> tuple[Tensor, Tensor]:
        """Colours (M, 3) of canonical surface points seen along canonical directions (M, 3).

        Returns:
            The colours and whether any photo sees the point (M,).
        """
        best = torch.full((len(points),), -2.0)
        colours = torch.zeros(len(points), 3)
        for view, depth, photo in zip(self.views, self.depths, self.photos, strict=True):
            direction = torch.nn.functional.normalize(points - view.camera.center, dim=-1)
            likeness = (direction * incoming).sum(dim=-1)
            found = look_up(points, view.camera, photo, depth)
            seen = (found.behind.abs() < _DEPTH_TOLERANCE) & (found.alpha > 0.95)
            seen &= likeness > best
            colours[seen] = found.colours[seen]
            best[seen] = likeness[seen]
        return colours, best > -2

    def picture(self, deformation: Deformation, camera: Camera) -> TruthView:
        """What `camera` sees of the deformed object, at the camera's own resolution."""
        fine = camera.resized(camera.width * _SUPERSAMPLING, camera.height * _SUPERSAMPLING)
        moved = deformation(torch.from_numpy(self.vertices)).numpy()
        directions = fine.rays().flat().directions
        caster = MeshCaster(moved, self.faces)
        ray, face, weights = caster.first_hits(
            camera.center.double().numpy(), directions.double().numpy()
        )
        corners = self.vertices[self.faces[face]]
        points = torch.from_numpy(np.einsum("mi,mij->mj", weights, corners)).float()
        jacobian = deformation.jacobian(points)
        incoming = torch.linalg.solve(jacobian, directions[ray].unsqueeze(-1)).squeeze(-1)
        incoming = torch.nn.functional.normalize(incoming, dim=-1)
        colours, seen = self.colours(points, incoming)
        rgba = torch.zeros(fine.height * fine.width, 4)
        rgba[torch.from_numpy(ray), :3] = colours
        rgba[torch.from_numpy(ray), 3] = 1.0
        full = rgba.reshape(fine.height, fine.width, 4)
        return TruthView(
            camera=camera,
            rgba=area_downscale(full, _SUPERSAMPLING),
            unseen=1 - float(seen.float().mean()),
        )
