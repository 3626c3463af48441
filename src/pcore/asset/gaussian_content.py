"""The content of an asset made of Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
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
from pcore.data.scene import View
from pcore.deform.jacobian import analytic_maps
from pcore.deform.pose import moved_points
from pcore.errors import InputError
from pcore.files.gaussian_file import (
    GAUSSIANS_FILE,
    SavedGaussians,
    load_gaussians,
    save_gaussians,
)
from pcore.files.provenance import Provenance
from pcore.gaussians.gaussian_rays import trace
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.pinhole import surface_points
from pcore.gaussians.render import (
    Footprint,
    GaussianPictures,
    PosedGaussians,
    pose,
    render,
)
from pcore.gaussians.splats import SplatsAtRest
from pcore.gaussians.wide_pixels import render_divided
from pcore.geometry.camera import Camera
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.rays import RayBundle
from pcore.geometry.surfels import Surfels
from pcore.relight.gaussian_light import LitPieces, fit_gaussian_light, gaussian_gains, lit_of
from pcore.relight.light_file import LIGHT_FILE, save_light
from pcore.relight.relighting import Relighting
from pcore.render.gaussian_surfels import observe_gaussians
from pcore.render.image import Image
from pcore.render.surfel_fit import Progress

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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class GaussianContent(Lit):
    """Gaussians at rest, and how they meet pixels.

    Attributes:
        gaussians: on the device that does the work.
        footprint: as they were trained.
        background: of their pictures.
        normals: (N, 3) of the pieces of surface that they are, unit, outwards, on the CPU; zero
            where that is not known; None where nobody has estimated them.
    """

    gaussians: Gaussians
    footprint: Footprint
    background: Color
    normals: Tensor | None = None

    @property
    def points(self) -> Tensor:
        """See `Content.points`: the means."""
        return self.gaussians.means.detach().cpu()

    @property
    def samples(self) -> int:
        """See `Content.samples`; the footprint is what a pixel is, so that one is enough."""
        return 1

    @cached_property
    def surfels(self) -> Surfels | None:
        """The pieces of surface that they are at rest; None where nobody has estimated them."""
        if self.normals is None:
            return None
        return Surfels.at_rest(self.points.float(), self.normals, torch.zeros(len(self.normals)))

    @cached_property
    def _lit_pieces(self) -> LitPieces | None:
        return None if self.surfels is None else LitPieces.of(self.surfels)

    def splats(self) -> SplatsAtRest:
        """See `Content.splats`: the Gaussians themselves."""
        return SplatsAtRest.of(self.gaussians)

    def pose(
        self, motion: Motion | None, *, rays: RaysName, light: LightName | None
    ) -> MovedGaussians:
        """See `Content.pose`; "plain" moves the means alone and leaves every shape as it is.

        The light stands still where there is one and shapes are carried along.
        """
        relighting = wanted_light(self.read_light, rays, light)
        if motion is None:
            return MovedGaussians(drawn=PosedGaussians(gaussians=self.gaussians))
        if isinstance(motion, MovedPoints):
            positions, maps = motion.positions, motion.local_maps
        else:
            rest = self.gaussians.means.cpu()
            positions = moved_points(motion, rest.double())
            # Autograd follows the map where it asks for that, and the means.
            asked = positions.requires_grad
            places = rest if asked else rest.detach()
            maps = analytic_maps(motion, places, followed=asked) if rays == "aware" else None
        device = self.gaussians.means.device
        positions = positions.to(self.gaussians.means)
        bad = int((~positions.isfinite().all(dim=1)).sum())
        if bad:
            raise InputError(
                f"pose: expected finite points, got NaN or infinity in {bad} of {len(positions)}; "
                "lower the amount of the deformation, or check its file"
            )
        if maps is None or rays == "plain":
            moved = replace(self.gaussians, means=positions)
            return MovedGaussians(drawn=PosedGaussians(gaussians=moved))
        linear = torch.linalg.inv(maps.to_rest.double()).to(positions).to(device)
        posed = MovedGaussians(drawn=pose(self.gaussians, positions, linear), maps=maps)
        world = motion.world if isinstance(motion, MovedPoints) else 1.0
        return posed if relighting is None else self._relit(posed, relighting, world)

    def _relit(
        self, posed: MovedGaussians, relighting: Relighting, world: float = 1.0
    ) -> MovedGaussians:
        """The same under a light that stands still."""
        pieces = self._lit_pieces
        if posed.maps is None or pieces is None:
            return posed
        means = posed.drawn.gaussians.means
        gains = gaussian_gains(relighting, pieces, means, posed.maps, world=world)
        return self.lit(posed, gains)

    def lit(self, posed: MovedGaussians, gains: Tensor | None) -> MovedGaussians:
        """See `Content.lit`."""
        if gains is None:
            return posed if self.light is None else self._relit(posed, self.light)
        factors = gains.to(posed.drawn.gaussians.means).unsqueeze(1)
        return replace(posed, drawn=replace(posed.drawn, gains=factors))

    def points_of(self, posed: MovedGaussians) -> Tensor:
        """See `Content.points_of`."""
        return posed.drawn.gaussians.means.cpu()

    def local_maps_of(self, posed: MovedGaussians) -> LocalMaps | None:
        """See `Content.local_maps_of`."""
        return posed.maps

    def gains_of(self, posed: MovedGaussians) -> Tensor | None:
        """See `Content.gains_of`."""
        gains = posed.drawn.gains
        return None if gains is None else gains.cpu().squeeze(1)

    def trace(
        self, posed: MovedGaussians, rays: RayBundle, background: Tensor | Color | None
    ) -> Image:
        """See `Content.trace`; rays are lines: the mean of many in a pixel is a picture's."""
        means = self.gaussians.means
        rays = rays.each(lambda one: one.to(means))
        color = torch.as_tensor(self.background if background is None else background).to(means)
        found = trace(posed.drawn, rays.flat(), background=color, footprint=self.footprint)
        depth = torch.where(found.alpha > _TRACE, found.depth, torch.nan)
        surface = rays.flat().at(depth)

        def pixels(values: Tensor) -> Tensor:
            values = values.reshape((*rays.shape, *values.shape[1:]))
            return values if rays.samples is None else values.nanmean(dim=len(rays.pixels))

        return Image(
            rgb=pixels(found.rgb),
            alpha=pixels(found.alpha),
            depth=pixels(depth),
            surface=pixels(surface),
        )

    def render(self, posed: MovedGaussians, camera: Camera, sampling: Sampling) -> Image:
        """See `Content.render`; finer and averaged where pixels are wider than the photos' were."""
        color = self.gaussians.means.new_tensor(self.background)
        cameras = list(camera)
        with torch.set_grad_enabled(posed.drawn.asks_gradient or camera.asks_gradient):
            draw = render if sampling.fast else render_divided
            found = draw(posed.drawn, cameras, footprint=self.footprint, background=color)
            images = [_image(found, index, one) for index, one in enumerate(cameras)]
        return images[0] if camera.count is None else Image.stack(images)

    def film_detail(self, posed: Sequence[MovedGaussians], cameras: Sequence[Camera]) -> None:
        """See `Content.film_detail`; there is nothing to share."""
        return

    def over(self, background: Color) -> GaussianContent:
        """See `Content.over`."""
        return replace(self, background=background)

    def save(self, folder: Path, provenance: Provenance) -> None:
        """See `Content.save`."""
        self.save_gaussians(folder, provenance)
        if self.light is not None:
            save_light(folder / LIGHT_FILE, self.light)

    def save_gaussians(self, folder: Path, provenance: Provenance) -> None:
        """Write the file of Gaussians alone, with their normals."""
        saved = SavedGaussians(
            gaussians=self.gaussians.detached().to("cpu"),
            footprint=self.footprint,
            provenance=provenance,
            normals=self.normals,
        )
        save_gaussians(folder / GAUSSIANS_FILE, saved)

    def with_light(
        self, views: Sequence[View], *, progress: Progress | None = None
    ) -> GaussianContent:
        """Return the same with normals and the light of photos.

        Args:
            views: that they were trained on.
            progress: told (views seen, views in all).

        Raises:
            InputError: too few Gaussians are pieces of a surface.
        """
        observed = observe_gaussians(self.gaussians, self.footprint, views, progress=progress)
        light = fit_gaussian_light(observed, self.points)
        return replace(self, normals=observed.normals, read_light=lambda: light)


def read_gaussians(path: Path, device: str) -> tuple[GaussianContent, Provenance]:
    """Read a file of Gaussians, or the one in a folder.

    Args:
        path: the file or the folder.
        device: for the drawing.

    Raises:
        CheckpointError: no Gaussians there, or they are damaged.
    """
    saved = load_gaussians(path)
    normals, means = saved.normals, saved.gaussians.means
    content = GaussianContent(
        gaussians=saved.gaussians.to(device),
        footprint=saved.footprint,
        background=saved.provenance.background,
        normals=normals,
        read_light=None if normals is None else light_beside(path, lambda: means[lit_of(normals)]),
    )
    return content, saved.provenance


def _image(found: GaussianPictures, index: int, camera: Camera) -> Image:
    """One of the pictures, with places only where something is seen."""
    alpha = found.alpha[index].cpu()
    depth = torch.where(alpha > _TRACE, found.depth[index].cpu(), torch.nan)
    return Image(
        rgb=found.rgb[index].cpu(),
        alpha=alpha,
        depth=depth,
        surface=surface_points(depth, camera),
    )
