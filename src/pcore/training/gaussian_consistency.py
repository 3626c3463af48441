"""P-CORE on Gaussians: what they show along deformed rays is what the photo shows along straight.

A field of which one affine map were true everywhere would change nothing: carried Gaussians look
from carried rays as they did before. What the losses see is the rest: Gaussians whose map differs
across their own extent, Gaussians behind the surface, whose map is another than the surface's, and
colours that are right in one order of blending only.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.data.images import background_color
from pcore.data.scene import View
from pcore.deform.base import Deformation
from pcore.deform.sampler import sample_deformation
from pcore.gaussians.gaussian_rays import Traced, trace
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import (
    Footprint,
    PosedGaussians,
    blended,
    pose,
    render,
)
from pcore.geometry.rays import RayBundle
from pcore.training.gaussian_config import GaussianFinetuneConfig
from pcore.training.losses import Losses, mean_of
from pcore.training.ranks import current_ranks
from pcore.training.ssim import picture_losses
from pcore.training.trainable_gaussians import TrainableGaussians, photo_on, valid_only

_VISIBLE = 0.05
"""Less opacity than this has no surface that could be moved."""


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What the canonical state says about R pixels; all without gradient.

    Attributes:
        surface: (R, 3) the surface point s of each pixel: the mean of the means that it blends.
        ends: (R, 3) beside them on the rays, where the deformed rays aim.
        widths: (R,) of the pixels there, world units.
        solid: (R,) whether the pixel shows the object.
        rgb: (R, 3) the photo.
    """

    surface: Tensor
    ends: Tensor
    widths: Tensor
    solid: Tensor
    rgb: Tensor


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """What chance decides about a photo of a step.

    Attributes:
        view: whose photo it is.
        color: (3,) behind the object.
        field: the deformation; None where no loss looks at one.
        pixels: source of the draw of pixels.
    """

    view: View
    color: Tensor
    field: Deformation | None
    pixels: torch.Generator


class GaussianObjective:
    """The losses of one step: photos, a random field each, one of the two modes."""

    def __init__(
        self,
        config: GaussianFinetuneConfig,
        work: TrainableGaussians,
        start: Gaussians,
        views: tuple[View, ...],
    ) -> None:
        self._config, self._work, self._views = config, work, views
        self._points = start.means.detach().cpu()
        self._lower, self._upper = self._points.amin(dim=0), self._points.amax(dim=0)
        self._unit = float((self._upper - self._lower).norm())

    def __call__(self) -> Losses:
        """L_rgb + lambda_geo L_geo + lambda_tex L_tex (paper, "Joint Loss") and regularisers.

        All processes draw everything, and each looks at its share.
        """
        batch = [self._draw() for _ in range(self._config.views)]
        found = [self._losses(one) for one in current_ranks().share(batch)]
        return mean_of(found, of=len(batch))

    def _draw(self) -> Drawn:
        config, generator = self._config, self._work.generator
        view = self._views[int(torch.randint(len(self._views), (), generator=generator))]
        color = background_color(config.background, generator)
        field, pixels = None, generator
        if config.consistent:
            field = sample_deformation(
                generator, self._lower, self._upper, self._points, config.ranges
            )
        if config.views > 1:
            # How far the draw of pixels goes depends on the picture, which is not drawn everywhere.
            seed = int(torch.randint(2**62, (), generator=generator))
            pixels = torch.Generator().manual_seed(seed)
        return Drawn(view=view, color=color, field=field, pixels=pixels)

    def _losses(self, drawn: Drawn) -> Losses:
        config, work, view = self._config, self._work, drawn.view
        gaussians, device = work.gaussians(), work.raw["means"].device
        color = drawn.color.to(device)
        picture = render(
            PosedGaussians(gaussians=gaussians),
            [view.camera],
            footprint=work.footprint,
            background=color,
        )
        photo = photo_on(view, color, device)
        rgb = valid_only(picture.rgb, photo, view.valid())
        found = picture_losses(rgb, photo, config.ssim_weight)
        terms = dict(found.terms)
        if config.needle_weight > 0:
            terms["needle"] = config.needle_weight * needles(gaussians.scales, config.needle)
        if drawn.field is not None:
            seen = seen_by(gaussians, work.footprint, view, photo, config, drawn.pixels)
            eye = view.camera.center.to(device)
            terms |= self._consistency(gaussians, seen, eye, drawn.field, color)
        return Losses(terms=terms, squared_error=found.squared_error)

    def _consistency(
        self, gaussians: Gaussians, seen: Seen, eye: Tensor, field: Deformation, color: Tensor
    ) -> dict[str, Tensor]:
        config = self._config
        both = config.points_only and config.rays_and_points
        moved_rays = self._work.step % 2 == 1 if both else config.rays_and_points
        rays, target = deformed_rays(
            seen, eye, field, config.origin_distance if moved_rays else None
        )
        traced = trace(
            carried_by(gaussians, field),
            rays,
            background=color,
            footprint=self._work.footprint,
            pixels=carried_pixels(seen, field),
        )
        found = consistency(traced, target, seen, unit=self._unit, reach=config.reach)
        mode = "rays" if moved_rays else "points"
        weights = {
            f"geo_{mode}": (config.geometry_weight, found.geometry),
            f"tex_{mode}": (config.texture_weight, found.texture),
            "spread": (config.spread_weight, found.spread),
        }
        return {name: weight * term for name, (weight, term) in weights.items() if weight > 0}


@torch.no_grad()
def seen_by(
    gaussians: Gaussians,
    footprint: Footprint,
    view: View,
    photo: Tensor,
    config: GaussianFinetuneConfig,
    generator: torch.Generator,
) -> Seen:
    """Draw pixels of a view that show something, and what they show (sg of the paper).

    Args:
        gaussians: at rest.
        footprint: as they were trained.
        view: whose photo it is.
        photo: (1, H, W, 3) over a background.
        config: how many, and which are foreground.
        generator: of the draw.
    """
    camera, valid = view.camera, view.valid()
    sums, alpha, depth = (
        one.reshape(camera.height * camera.width, -1)
        for one in blended(gaussians, gaussians.means, camera, footprint=footprint)
    )
    visible = alpha[:, 0] > _VISIBLE
    if valid is not None:
        visible &= valid.reshape(-1).to(visible.device)
    shown = visible.nonzero().squeeze(-1)
    order = torch.randperm(len(shown), generator=generator)[: config.rays]
    chosen = shown[order.to(shown.device)]
    surface = sums[chosen] / alpha[chosen]
    rays = camera.rays().flat().to(str(surface.device))[chosen]
    along, _ = rays.beside(surface)
    return Seen(
        surface=surface,
        ends=rays.origins + along * rays.directions,
        widths=depth[chosen, 0] / (sum(camera.focal) / 2),
        solid=alpha[chosen, 0] > config.foreground_alpha,
        rgb=photo[0].reshape(-1, 3)[chosen],
    )


def deformed_rays(
    seen: Seen, eye: Tensor, field: Deformation, origin_distance: float | None
) -> tuple[RayBundle, Tensor]:
    """Rays (R,) to where a field takes their ends, and where it takes the surface (R, 3).

    Args:
        seen: the surface at rest.
        eye: (3,) of the camera.
        field: the deformation D.
        origin_distance: None leaves the origins at the camera ("points-only mode"); else they are
            put before the surface, at this share of the way to the camera, and deformed as well
            ("rays-and-points mode").
    """
    ends = moved(field, seen.ends)
    origins = eye.expand_as(ends)
    if origin_distance is not None:
        origins = moved(field, seen.ends + origin_distance * (eye - seen.ends))
    rays = RayBundle(origins=origins, directions=F.normalize(ends - origins, dim=-1))
    return rays, moved(field, seen.surface)


def moved(field: Deformation, points: Tensor) -> Tensor:
    """Where a field takes points (..., 3), computed in float64; differentiable."""
    return field(points.double()).to(points)


def carried_by(gaussians: Gaussians, field: Deformation) -> PosedGaussians:
    """Gaussians as an edit by this field draws them, with gradients to everything but the maps."""
    maps = field.jacobian(gaussians.means.detach().double()).to(gaussians.means)
    return pose(gaussians, moved(field, gaussians.means), maps)


def carried_pixels(seen: Seen, field: Deformation) -> Tensor:
    """(R, 3, 3) squared widths of the pixels, carried along as the surface in them is.

    So the texture keeps its sharpness in a part that is stretched: the photo is compared with what
    its own pixel has become.
    """
    maps = field.jacobian(seen.ends.double()).to(seen.ends)
    return maps @ maps.mT * seen.widths.square()[:, None, None]


@dataclass(frozen=True, kw_only=True)
class GaussianConsistency:
    """Means over rays whose target nothing hides.

    Attributes:
        geometry: L_geo, squared distance of the surface from where it should be, squared `unit`s.
        texture: L_tex, absolute difference of colours.
        spread: variance of the depth of what is blended, squared `unit`s.
    """

    geometry: Tensor
    texture: Tensor
    spread: Tensor


def consistency(
    traced: Traced, target: Tensor, seen: Seen, *, unit: float, reach: float
) -> GaussianConsistency:
    """Compare what deformed rays see with what the deformation makes of the canonical surface.

    Args:
        traced: of the carried Gaussians.
        target: (R, 3) the deformed surface.
        seen: what the canonical state says.
        unit: of L_geo, world units.
        reach: rays that see something farther than this from their target, in units, are left out:
            another part came before it.
    """
    squares = ((traced.centroid - target) / unit).square().sum(dim=-1)
    met = squares.detach() < reach**2
    count = met.sum().clamp_min(1)
    texture = (traced.rgb - seen.rgb).abs().mean(dim=-1)
    return GaussianConsistency(
        geometry=(squares * (met & seen.solid)).sum() / count,
        texture=(texture * met).sum() / count,
        spread=(traced.spread * met).sum() / count / unit**2,
    )


def needles(scales: Tensor, longest: float) -> Tensor:
    """How much longer than `longest` times their second axis Gaussians (N, 3) are, mean of logs."""
    ranked = scales.sort(dim=-1).values
    return F.relu((ranked[:, 2] / ranked[:, 1] / longest).log()).mean()
