"""The content of an asset that PAPR learned: networks, a canonical cloud, and perhaps a light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from torch import Tensor

from pcore.asset.content import Color, LightName, Motion, MovedPoints, RaysName, Sampling
from pcore.editing.apply import deformed_cloud
from pcore.errors import InputError
from pcore.files.model_file import MODEL_FILE, load_model, networks, save_model
from pcore.files.provenance import Provenance
from pcore.geometry.camera import Camera
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.model.papr import Papr, Rendering
from pcore.model.passes import Picture
from pcore.model.raster import film_detail
from pcore.model.render import FAST_THRESHOLD, render
from pcore.relight.light_file import LIGHT_FILE, load_shading, save_shading
from pcore.relight.shading import Shading


@dataclass(frozen=True, kw_only=True, eq=False)
class NeuralPoints:
    """Networks and canonical points; posed, they are a deformed `PointCloud`.

    Attributes:
        papr: the networks, without gradients, on the device that does the work.
        cloud: canonical points, on the CPU.
        read_light: gives the light of the photos; None where none was estimated.
    """

    papr: Papr
    cloud: PointCloud
    read_light: Callable[[], Shading] | None = None

    @property
    def light(self) -> Shading | None:
        """The light of the photos, read when it is first needed.

        Raises:
            CheckpointError: its file is damaged or belongs to other points.
        """
        return None if self.read_light is None else self.read_light()

    @property
    def points(self) -> Tensor:
        """See `Content.points`."""
        return self.cloud.positions

    @property
    def samples(self) -> int:
        """See `Content.samples`."""
        return self.papr.config.samples

    def pose(self, motion: Motion | None, *, rays: RaysName, light: LightName | None) -> PointCloud:
        """See `Content.pose`; the light stands still where there is one and rays are aware.

        Points that no map of space moved have pictures as deep as the points, with a light or not,
        so that figures of depth compare.
        """
        shading = self._shading(rays, light)
        if motion is None:
            return self.cloud.covered(shading and shading.rest)
        if not isinstance(motion, MovedPoints):
            return deformed_cloud(self.cloud, motion, aware=rays == "aware", shading=shading)
        maps = motion.local_maps
        moved = self.cloud.detached().moved(motion.positions, maps if rays == "aware" else None)
        if shading is None or maps is None:
            return moved
        skin = shading.skin(maps, moved.positions, world=motion.world)
        return moved.covered(replace(skin, deep=False))

    def points_of(self, posed: PointCloud) -> Tensor:
        """See `Content.points_of`."""
        return posed.positions

    def local_maps_of(self, posed: PointCloud) -> LocalMaps | None:
        """See `Content.local_maps_of`."""
        return posed.frames

    def trace(self, posed: PointCloud, rays: RayBundle, background: Tensor | None) -> Rendering:
        """See `Content.trace`."""
        return self.papr(posed, rays, background)

    def render(self, posed: PointCloud, camera: Camera, sampling: Sampling) -> Picture:
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

    def film_detail(self, posed: Sequence[PointCloud], cameras: Sequence[Camera]) -> float:
        """See `Content.film_detail`."""
        return film_detail(self.papr.config, posed, cameras)

    def over(self, background: Color) -> NeuralPoints:
        """See `Content.over`; the background only enters after the networks."""
        papr = networks(replace(self.papr.config, background=background), self.papr.state_dict())
        device = next(self.papr.parameters()).device
        return replace(self, papr=papr.to(device))

    def save(self, folder: Path, provenance: Provenance) -> None:
        """See `Content.save`."""
        save_model(
            folder / MODEL_FILE, self.papr.state_dict(), self.cloud, self.papr.config, provenance
        )
        if self.light is not None:
            save_shading(folder / LIGHT_FILE, self.light)

    def _shading(self, rays: RaysName, light: LightName | None) -> Shading | None:
        if light == "baked" or (light is None and rays == "plain"):
            return None
        if light == "still" and self.read_light is None:
            raise InputError(
                f"light: expected a {LIGHT_FILE} in the folder of the run, found none; estimate it "
                "with `pcore light RUN`, or let it be baked in (--light baked)"
            )
        return self.light


def read_neural_points(path: Path, device: str) -> tuple[NeuralPoints, Provenance]:
    """Read a model file, or the one in a folder with the light that lies beside it.

    Args:
        path: the file or the folder.
        device: for the networks.

    Raises:
        CheckpointError: no model there, or it is damaged.
    """
    saved = load_model(path)
    light = path / LIGHT_FILE
    cloud = saved.cloud

    @cache
    def read_light() -> Shading:
        return load_shading(light, cloud.positions)

    content = NeuralPoints(
        papr=saved.papr().to(device),
        cloud=cloud,
        read_light=read_light if light.is_file() else None,
    )
    return content, saved.provenance
