"""The content of an asset made of Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from pcore.asset.content import Color, LightName, Motion, MovedPoints, RaysName, Sampling
from pcore.deform.jacobian import analytic_maps
from pcore.errors import InputError
from pcore.files.gaussian_file import (
    GAUSSIANS_FILE,
    SavedGaussians,
    load_gaussians,
    save_gaussians,
)
from pcore.files.provenance import Provenance
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint, PosedGaussians, pose, render, surface_points
from pcore.geometry.camera import Camera
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.rays import RayBundle
from pcore.render.image import Image

_TRACE = 1e-6
"""Less opacity than this shows nothing that could have a depth."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MovedGaussians:
    """Gaussians as an edit leaves them.

    Attributes:
        drawn: what is drawn, on the device that does the work.
        maps: how space moved around their means; None where nothing remembers it.
    """

    drawn: PosedGaussians
    maps: LocalMaps | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class GaussianContent:
    """Gaussians at rest, and how they meet pixels.

    Attributes:
        gaussians: on the device that does the work.
        footprint: as they were trained.
        background: of their pictures.
    """

    gaussians: Gaussians
    footprint: Footprint
    background: Color

    @property
    def points(self) -> Tensor:
        """See `Content.points`: the means."""
        return self.gaussians.means.detach().cpu()

    @property
    def samples(self) -> int:
        """See `Content.samples`; the footprint is what a pixel is, so that one is enough."""
        return 1

    @property
    def light(self) -> None:
        """See `Content.light`; baked into the colours."""
        return

    def pose(
        self, motion: Motion | None, *, rays: RaysName, light: LightName | None
    ) -> MovedGaussians:
        """See `Content.pose`; "plain" moves the means alone and leaves every shape as it is."""
        if light == "still":
            raise InputError(
                "light: expected an object whose light was estimated, got Gaussians, whose light "
                "is baked into their colours; leave it so (--light baked)"
            )
        if motion is None:
            return MovedGaussians(drawn=PosedGaussians(gaussians=self.gaussians))
        if isinstance(motion, MovedPoints):
            positions, maps = motion.positions, motion.local_maps
        else:
            exact = self.points.double()
            positions = motion(exact)
            maps = analytic_maps(motion, self.points) if rays == "aware" else None
        device = self.gaussians.means.device
        positions = positions.to(self.gaussians.means)
        if maps is None or rays == "plain":
            moved = replace(self.gaussians, means=positions)
            return MovedGaussians(drawn=PosedGaussians(gaussians=moved))
        linear = torch.linalg.inv(maps.to_rest.double()).to(positions)
        return MovedGaussians(drawn=pose(self.gaussians, positions, linear.to(device)), maps=maps)

    def points_of(self, posed: MovedGaussians) -> Tensor:
        """See `Content.points_of`."""
        return posed.drawn.gaussians.means.detach().cpu()

    def local_maps_of(self, posed: MovedGaussians) -> LocalMaps | None:
        """See `Content.local_maps_of`."""
        return posed.maps

    def trace(self, posed: MovedGaussians, rays: RayBundle, background: Tensor | None) -> Image:
        """See `Content.trace`; Gaussians are drawn picture by picture and meet no single rays.

        Raises:
            InputError: always; `pcore.gaussians.render` draws with gradients.
        """
        raise InputError(
            "trace: expected an object of neural points, got Gaussians, which are drawn by cameras "
            "and not by rays; take `render`, or `pcore.gaussians.render.render` for gradients"
        )

    @torch.no_grad()
    def render(self, posed: MovedGaussians, camera: Camera, sampling: Sampling) -> Image:
        """See `Content.render`; one pass, whose footprint needs no samples."""
        color = self.gaussians.means.new_tensor(self.background)
        found = render(posed.drawn, [camera], footprint=self.footprint, background=color)
        alpha = found.alpha[0].cpu()
        depth = torch.where(alpha > _TRACE, found.depth[0].cpu(), torch.nan)
        return Image(
            rgb=found.rgb[0].cpu(),
            alpha=alpha,
            depth=depth,
            surface=surface_points(depth, camera),
        )

    def film_detail(self, posed: Sequence[MovedGaussians], cameras: Sequence[Camera]) -> None:
        """See `Content.film_detail`; there is nothing to share."""
        return

    def over(self, background: Color) -> GaussianContent:
        """See `Content.over`."""
        return replace(self, background=background)

    def save(self, folder: Path, provenance: Provenance) -> None:
        """See `Content.save`."""
        plain = self.gaussians.detached().to("cpu")
        save_gaussians(
            folder / GAUSSIANS_FILE,
            SavedGaussians(gaussians=plain, footprint=self.footprint, provenance=provenance),
        )


def read_gaussians(path: Path, device: str) -> tuple[GaussianContent, Provenance]:
    """Read a file of Gaussians, or the one in a folder.

    Args:
        path: the file or the folder.
        device: for the drawing.

    Raises:
        CheckpointError: no Gaussians there, or they are damaged.
    """
    saved = load_gaussians(path)
    content = GaussianContent(
        gaussians=saved.gaussians.to(device),
        footprint=saved.footprint,
        background=saved.provenance.background,
    )
    return content, saved.provenance
