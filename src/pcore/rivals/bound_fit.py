"""Training of Gaussians that hang on the triangles of a mesh, by our own trainer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pcore.data.scene import Scene
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint, PosedGaussians
from pcore.geometry.camera import Camera
from pcore.render.distance_grid import DistanceGrid
from pcore.render.fusion import depth_view, fused_distances
from pcore.render.image import Image
from pcore.rivals.cage_mesh import largest_piece
from pcore.rivals.mesh_bound import PER_TRIANGLE, hung, placed, start_on, triangle_frames
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.gaussian_fit import fit_gaussians
from pcore.training.trainable_gaussians import Bound

FINEST, COARSEST = 96, 8
_TRIES = 4
_VIEWS = 40
"""More add nothing at these sizes."""
_MARGIN = 0.06
"""Share of the object's longest side around it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BoundGaussians:
    """Gaussians on a mesh.

    Attributes:
        vertices: (V, 3) at rest, world units.
        faces: (F, 3).
        gaussians: 3 F of them in the world at rest, three after three.
        footprint: how they meet pixels.
    """

    vertices: Tensor
    faces: Tensor
    gaussians: Gaussians
    footprint: Footprint

    def carried(self, moved: Tensor) -> PosedGaussians:
        """The Gaussians when the vertices (V, 3) are elsewhere; colours are not turned.

        Raises:
            InputError: a triangle has lost its area.
        """
        local = hung(self.gaussians, triangle_frames(self.vertices, self.faces))
        frames = triangle_frames(moved.to(self.vertices), self.faces)
        return PosedGaussians(gaussians=placed(local, frames))


def sized_mesh(
    draw: Callable[[Camera], Image],
    scene: Scene,
    points: Tensor,
    triangles: int,
) -> tuple[DistanceGrid, Tensor, Tensor]:
    """Fuse depth as finely as makes about so many triangles; see `fused_distances`.

    Raises:
        InputError: there is no surface.
        DependencyError: scikit-image is not installed.
    """
    cameras = [view.camera for view in scene.split("train")]
    chosen = {int(k) for k in torch.linspace(0, len(cameras) - 1, min(_VIEWS, len(cameras)))}
    views = [depth_view(draw(cameras[k]), cameras[k]) for k in sorted(chosen)]
    lower, upper = (points.float().quantile(share, dim=0) for share in (0.01, 0.99))
    side = float((upper - lower).max())
    lower, upper, side = lower - _MARGIN * side, upper + _MARGIN * side, (1 + 2 * _MARGIN) * side
    cells, tries = 40, _TRIES
    while True:
        voxel = side / cells
        fused = fused_distances(views, lower, upper, voxel, smooth=0.0, closed=True, free=1.0)
        vertices, faces = largest_piece(fused)
        tries -= 1
        # Triangles grow with the square of the cells.
        better = min(max(round(cells * (triangles / len(faces)) ** 0.5), COARSEST), FINEST)
        if better == cells or not tries:
            return fused, vertices, faces
        cells = better


def fit_bound(
    scene: Scene, vertices: Tensor, faces: Tensor, config: GaussianConfig
) -> BoundGaussians:
    """Train three Gaussians a triangle; their number stays.

    Rates are ours, for places in lengths of the triangles.

    Raises:
        TrainingError: diverged.
    """
    frames = triangle_frames(vertices, faces)
    start = start_on(vertices, faces, degree=config.degree, opacity=0.5)
    size = float(frames.sizes.median())
    rate = config.rates.means
    rates = replace(config.rates, means=replace(rate, base=rate.base / size))
    fixed = replace(config, rates=rates, density=replace(config.density, last=0.0))
    bound = Bound(start=start, place=lambda local: placed(local, frames))
    found = fit_gaussians(scene, fixed, bound=bound)
    assert len(found.gaussians) == PER_TRIANGLE * len(faces)
    return BoundGaussians(
        vertices=vertices,
        faces=faces,
        gaussians=found.gaussians.each(torch.Tensor.detach),
        # As it is kept (`kept.py`): rivals are drawn as finely as they were trained.
        footprint=replace(found.footprint, pixel=None),
    )
