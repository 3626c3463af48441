"""The content of an asset that PAPR learned: networks, canonical points, surfels, a light."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from pcore.asset.content import (
    Color,
    LightName,
    Lit,
    Motion,
    MovedPoints,
    RaysName,
    Sampling,
    light_beside,
    wanted_light,
)
from pcore.deform.pose import pose
from pcore.errors import InputError
from pcore.files.model_file import MODEL_FILE, load_model, save_model
from pcore.files.provenance import Provenance
from pcore.gaussians.splats import SplatsAtRest
from pcore.geometry.camera import Camera
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.geometry.surfels import Surfels
from pcore.model.papr import Papr
from pcore.relight.light_file import LIGHT_FILE, save_light
from pcore.relight.relighting import Relighting
from pcore.render.image import Image
from pcore.render.own_splats import own_splats
from pcore.render.picture import FAST_THRESHOLD, render, render_rays
from pcore.render.raster import film_detail


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class NeuralPoints(Lit):
    """Networks and canonical points; posed, they are a `PosedCloud`.

    Attributes:
        papr: the networks, on the device that does the work.
        cloud: canonical points, on the CPU.
        surfels: the surface over them at rest; None where nobody has estimated it.
    """

    papr: Papr
    cloud: PointCloud
    surfels: Surfels | None = None

    @property
    def points(self) -> Tensor:
        """See `Content.points`."""
        return self.cloud.positions.detach()

    @property
    def samples(self) -> int:
        """See `Content.samples`."""
        return self.papr.config.samples

    def splats(self) -> SplatsAtRest:
        """See `Content.splats`: flat ones over the points; takes a second."""
        made = own_splats(self.papr, PosedCloud.at_rest(self.cloud, self.surfels))
        return SplatsAtRest.of(made, self.points)

    def pose(self, motion: Motion | None, *, rays: RaysName, light: LightName | None) -> PosedCloud:
        """See `Content.pose`; the light stands still where there is one and rays are aware."""
        relighting = self._relighting(rays, light)
        posed = self._moved(motion, aware=rays == "aware")
        still = posed.positions is posed.cloud.positions
        if relighting is None or still or posed.surfels is None:
            return posed
        world = motion.world if isinstance(motion, MovedPoints) else 1.0
        return replace(posed, gains=relighting.gains(posed, world=world))

    def lit(self, posed: PosedCloud, gains: Tensor | None) -> PosedCloud:
        """See `Content.lit`."""
        still = posed.positions is posed.cloud.positions
        if gains is None and (self.light is None or still or posed.surfels is None):
            return posed
        if gains is None:
            assert self.light is not None
            gains = self.light.gains(posed)
        return replace(posed, gains=gains) if posed.surfels is not None else posed

    def _moved(self, motion: Motion | None, *, aware: bool) -> PosedCloud:
        """The points where a motion takes them, as they were photographed."""
        if motion is None:
            return PosedCloud.at_rest(self.cloud, self.surfels)
        if not isinstance(motion, MovedPoints):
            return pose(self.cloud, motion, surfels=self.surfels, aware=aware)
        maps, positions = motion.local_maps, motion.positions
        if maps is None and torch.equal(positions, self.cloud.positions):
            return PosedCloud.at_rest(self.cloud, self.surfels)
        surfels = None
        if maps is not None and self.surfels is not None:
            surfels = self.surfels.moved(positions, maps)
        return PosedCloud(
            cloud=self.cloud,
            positions=positions,
            local_maps=maps if aware else None,
            surfels=surfels,
        )

    def points_of(self, posed: PosedCloud) -> Tensor:
        """See `Content.points_of`."""
        return posed.positions

    def local_maps_of(self, posed: PosedCloud) -> LocalMaps | None:
        """See `Content.local_maps_of`."""
        return posed.local_maps

    def gains_of(self, posed: PosedCloud) -> Tensor | None:
        """See `Content.gains_of`."""
        return posed.gains

    def trace(self, posed: PosedCloud, rays: RayBundle, background: Tensor | Color | None) -> Image:
        """See `Content.trace`."""
        like = next(self.papr.parameters()).detach()
        color = None if background is None else torch.as_tensor(background).to(like)
        sent = rays.each(lambda one: one.to(like))
        return render_rays(self.papr, posed.to(like.device), sent, color)

    def render(self, posed: PosedCloud, camera: Camera, sampling: Sampling) -> Image:
        """See `Content.render`."""
        few = sampling.fast and sampling.samples is None
        return render(
            self.papr,
            posed,
            camera,
            threshold=FAST_THRESHOLD if sampling.fast else 0.0,
            samples=1 if few else sampling.samples,
            detail=sampling.detail,
            cancel=sampling.cancel,
            progress=sampling.progress,
        )

    def film_detail(self, posed: Sequence[PosedCloud], cameras: Sequence[Camera]) -> float:
        """See `Content.film_detail`."""
        return film_detail(self.papr.config, posed, cameras)

    def over(self, background: Color) -> NeuralPoints:
        """See `Content.over`; the background only enters after the networks."""
        papr = copy(self.papr)  # Of the same parameters.
        papr.config = replace(papr.config, background=background)
        return replace(self, papr=papr)

    def save(self, folder: Path, provenance: Provenance) -> None:
        """See `Content.save`."""
        self.save_model(folder, provenance)
        if self.light is not None:
            save_light(folder / LIGHT_FILE, self.light)

    def save_model(self, folder: Path, provenance: Provenance) -> None:
        """Write the model file alone, with the surface over the points."""
        state, config = self.papr.state_dict(), self.papr.config
        save_model(folder / MODEL_FILE, state, self.cloud, config, provenance, self.surfels)

    def _relighting(self, rays: RaysName, light: LightName | None) -> Relighting | None:
        found = wanted_light(self.read_light, rays, light)
        if self.surfels is None and found is not None:
            raise InputError(
                f"light: expected the surface over the points in {MODEL_FILE}, which light falls "
                "on, found none; estimate both with `pcore light RUN`"
            )
        return found


def read_neural_points(path: Path, device: str) -> tuple[NeuralPoints, Provenance]:
    """Read a model file, or the one in a folder with the light that lies beside it.

    Args:
        path: the file or the folder.
        device: for the networks.

    Raises:
        CheckpointError: no model there, or it is damaged.
    """
    saved = load_model(path)
    cloud = saved.cloud
    content = NeuralPoints(
        papr=saved.papr().to(device),
        cloud=cloud,
        surfels=saved.surfels,
        read_light=light_beside(path, lambda: cloud.positions),
    )
    return content, saved.provenance
