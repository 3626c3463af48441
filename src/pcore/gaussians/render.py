"""Pictures of Gaussians, flat ones too, by cameras of ours: colours, opacity, depth, gradients.

One filter in training and drawing alike: what a pixel is, a square of one pixel, whose variance is
1 / 12 along each side. The opacity gives up what the filter adds to the area, so that small
Gaussians fade instead of growing (Yu et al. 2024).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.gaussians.carry import carried_axes, polar
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.pinhole import view_matrices
from pcore.gaussians.spherical_harmonics import colors
from pcore.geometry.camera import Camera
from pcore.kernels.backends import of_gaussians
from pcore.kernels.disc_rasterization import rasterization_2dgs
from pcore.kernels.gaussian_rasterization import RenderMode, rasterization

PIXEL = 1 / 12
"""Variance of a pixel, pixels squared."""
_NEAR = 0.02
"""Gaussians nearer than this share of the mean distance are not drawn: at the camera itself the
picture of a Gaussian is no Gaussian."""


@dataclass(frozen=True, kw_only=True)
class Footprint:
    """How a Gaussian meets pixels; the same in training and drawing.

    Files of other trainers were made with a variance of 0.3 and mostly without `antialiased`.
    """

    variance: float = PIXEL
    """Of the screen filter, pixels squared."""
    antialiased: bool = True
    """Whether the opacity gives up what the filter adds to the area."""
    flat: bool = False
    """Whether the first two axes are a disc that rays meet (2DGS); the third is then its normal, of
    no size. Published flat Gaussians have a variance of 0.5 and are not antialiased."""
    pixel: float | None = None
    """Width of the widest pixel that they learned from, on the object, world units
    (`wide_pixels.pixel_width`); None where nobody knows."""

    def __post_init__(self) -> None:
        if not 0 < self.variance < float("inf"):
            raise InputError(
                f"footprint: expected a finite variance above 0, got {self.variance} pixels squared"
            )
        if self.pixel is not None and not 0 < self.pixel < float("inf"):
            raise InputError(
                f"footprint: expected a finite width of a pixel above 0, got {self.pixel} units"
            )


@dataclass(frozen=True, kw_only=True)
class PosedGaussians:
    """Gaussians as they are drawn.

    Attributes:
        gaussians: means, opacities and colours where they are now; also the shapes, if there are no
            covariances.
        axes: (N, 3, 3) axes in the columns, as long as standard deviations, world units; they need
            not be perpendicular. None takes scales and quaternions.
        turns: (N, 3, 3) orthogonal: along d each shows the colours that it has along turns^T d at
            rest. None leaves them.
        gains: (N, 1) or (N, 3) factors on the colours, for a light; None leaves them.
    """

    gaussians: Gaussians
    axes: Tensor | None = None
    turns: Tensor | None = None
    gains: Tensor | None = None

    @property
    def asks_gradient(self) -> bool:
        """Whether autograd follows any of it."""
        own = self.gaussians
        parts = (own.means, own.quats, own.scales, own.opacities, own.sh)
        parts = (*parts, self.axes, self.turns, self.gains)
        followed = any(one is not None and one.requires_grad for one in parts)
        return torch.is_grad_enabled() and followed

    @property
    def covariances(self) -> Tensor | None:
        """(N, 3, 3) of the axes, world units squared; None where there are none."""
        return None if self.axes is None else self.axes @ self.axes.mT

    def colors(self, directions: Tensor, which: Tensor | None = None) -> Tensor:
        """What they show, times the gains; differentiable in both and in the directions.

        Args:
            directions: (..., N, 3) of unit length, from the camera to each.
            which: (N,) indices of those that are asked for; None is all of them.

        Returns:
            (..., N, 3) not negative; more than 1 is possible.
        """

        def chosen(values: Tensor) -> Tensor:
            return values if which is None else values.index_select(0, which)

        if self.turns is not None:
            directions = (directions.unsqueeze(-1) * chosen(self.turns)).sum(dim=-2)
        rgb = colors(chosen(self.gaussians.sh), directions)
        return rgb if self.gains is None else rgb * chosen(self.gains)


@dataclass(frozen=True, kw_only=True)
class GaussianPictures:
    """What C cameras see.

    Attributes:
        rgb: (C, H, W, 3) over the background, not clamped.
        alpha: (C, H, W) opacity.
        depth: (C, H, W) median camera z of what is drawn (`rasterization`), world units; of
            gsplat, which knows no other, the expected one. 0 where nothing is.
        means2d: (C, N, 2) columns and rows of the centres, pixels; its gradient can be retained.
        normals: (C, H, W, 3) sums of the unit normals of flat Gaussians, in the world, by their
            weights; None of others, and where no depth was asked for.
    """

    rgb: Tensor
    alpha: Tensor
    depth: Tensor
    means2d: Tensor
    normals: Tensor | None = None


def pose(
    gaussians: Gaussians, positions: Tensor, local_maps: Tensor, gains: Tensor | None = None
) -> PosedGaussians:
    """Gaussians carried along by a map of space that is known at their means.

    Unlike `carried` this is differentiable in positions and local maps, and knows no scales,
    quaternions and harmonics of the result: these stay as they are at rest, and are looked at from
    where they are seen now, which takes a tenth of the time.

    Args:
        gaussians: N of them at rest.
        positions: (N, 3) where their means go, world units.
        local_maps: (N, 3, 3) Jacobians J there: axes A become J A, covariances J S J^T.
        gains: (N, 1) or (N, 3) factors on the colours.
    """
    return PosedGaussians(
        gaussians=replace(gaussians, means=positions),
        axes=carried_axes(gaussians, local_maps),
        turns=polar(local_maps).to(gaussians.sh) if gaussians.degree > 0 else None,
        gains=gains,
    )


def render(
    posed: PosedGaussians,
    cameras: Sequence[Camera],
    *,
    footprint: Footprint,
    background: Tensor | None = None,
) -> GaussianPictures:
    """Draw what cameras of one picture size see.

    Args:
        posed: N Gaussians; on the CPU or, by gsplat, a GPU.
        cameras: C of them.
        footprint: as the Gaussians were trained.
        background: (3,) or (C, 3) colours; None is white.

    Returns:
        C pictures, differentiable in the Gaussians, gains, background, poses and focal lengths.

    Raises:
        InputError: no camera, or cameras of several sizes.
        DependencyError: on a GPU without gsplat.
    """
    sizes = {(camera.width, camera.height) for camera in cameras}
    if len(sizes) != 1:
        raise InputError(
            f"rendering of Gaussians: expected cameras of one picture size, got {sorted(sizes)}"
        )
    ((width, height),) = sizes
    viewmats, intrinsics = view_matrices(cameras, posed.gaussians.means)
    return render_views(
        posed, viewmats, intrinsics, (width, height), footprint=footprint, background=background
    )


def render_views(
    posed: PosedGaussians,
    viewmats: Tensor,
    intrinsics: Tensor,
    size: tuple[int, int],
    *,
    footprint: Footprint,
    background: Tensor | None = None,
    depth: bool = True,
) -> GaussianPictures:
    """Draw as `render`, by matrices, which gradients reach: pose and focal length.

    Args:
        posed: N Gaussians.
        viewmats: (C, 4, 4) camera from world, OpenCV axes; rigid.
        intrinsics: (C, 3, 3) without skew, pixels.
        size: width and height, pixels.
        footprint: as the Gaussians were trained.
        background: (3,) or (C, 3) colours; None is white.
        depth: whether depths are asked for; without, they are all 0.
    """
    gaussians = posed.gaussians
    rotation, shift = viewmats[:, :3, :3], viewmats[:, :3, 3:]
    centers = -(rotation.mT @ shift).squeeze(-1)
    offsets = gaussians.means - centers.unsqueeze(1)
    distances = offsets.norm(dim=-1, keepdim=True)
    directions = gaussians.means  # Of degree 0 the colour is the same from everywhere.
    if gaussians.degree > 0:
        directions = offsets / distances.clamp_min(torch.finfo(distances.dtype).tiny)
    rgb = posed.colors(directions)
    if background is None:
        background = gaussians.means.new_ones(3)
    near = _NEAR * float(distances.detach().mean()) if len(gaussians) else _NEAR
    image, alpha, normals, meta = _rasterized(
        posed,
        rgb,
        (viewmats, intrinsics, size),
        near,
        footprint,
        background=background.to(gaussians.means).expand(len(viewmats), 3),
        render_mode=_with_depth(posed) if depth else "RGB",
    )
    alpha = alpha[..., 0]
    return GaussianPictures(
        rgb=image[..., :3],
        alpha=alpha,
        depth=image[..., 3] if depth else torch.zeros_like(alpha),
        means2d=meta["means2d"],
        normals=normals if depth else None,
    )


def _with_depth(posed: PosedGaussians) -> RenderMode:
    """How colours and the best depth that there is are asked for."""
    return "RGB+ED" if of_gaussians(posed.gaussians.means) == "gsplat" else "RGB+MD"


def _rasterized(
    posed: PosedGaussians,
    values: Tensor,
    looks: tuple[Tensor, Tensor, tuple[int, int]],
    near_plane: float,
    footprint: Footprint,
    *,
    background: Tensor | None = None,
    render_mode: RenderMode = "RGB+ED",
) -> tuple[Tensor, Tensor, Tensor | None, dict[str, Any]]:
    """Pictures, alphas, normals of flat ones, and more, by the kernels of either kind."""
    own, axes = posed.gaussians, posed.axes
    options: dict[str, Any] = {
        "near_plane": near_plane,
        "eps2d": footprint.variance,
        "rasterize_mode": "antialiased" if footprint.antialiased else "classic",
        "backgrounds": background,
        "render_mode": render_mode,
    }
    viewmats, intrinsics, size = looks
    given = (own.means, own.quats, own.scales, own.opacities, values, viewmats, intrinsics, *size)
    if footprint.flat:
        tangents = None if axes is None else axes[..., :2]
        return rasterization_2dgs(*given, **options, tangents=tangents)
    image, alpha, meta = rasterization(*given, **options, covars=posed.covariances)
    return image, alpha, None, meta


def blended(
    gaussians: Gaussians, values: Tensor, camera: Camera, *, footprint: Footprint
) -> tuple[Tensor, Tensor, Tensor]:
    """Blend any values of Gaussians at rest as their colours are blended, over zeros.

    Linear in the values: its gradient to them sums pixels by the weights of the blending.

    Args:
        gaussians: N of them.
        values: (N, D).
        camera: who looks.
        footprint: as the Gaussians were trained.

    Returns:
        Values (H, W, D), opacity (H, W) and expected camera z (H, W), world units; 0 where nothing
        is.
    """
    viewmats, intrinsics = view_matrices([camera], gaussians.means)
    distances = (gaussians.means.detach() - camera.center.to(gaussians.means)).norm(dim=-1)
    image, alpha, *_ = _rasterized(
        PosedGaussians(gaussians=gaussians),
        values,
        (viewmats, intrinsics, (camera.width, camera.height)),
        _NEAR * float(distances.mean()),
        footprint,
    )
    return image[0, ..., :-1], alpha[0, ..., 0], image[0, ..., -1]
