"""Public face of the Gaussian kernels: gsplat's signature, the backend chosen by `backends`."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Any, Literal

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.kernels import cpu_gaussians, gaussian_projection, reference_gaussians
from pcore.kernels.backends import of_gaussians

RasterizeMode = Literal["classic", "antialiased"]
RenderMode = Literal["RGB", "RGB+ED", "RGB+MD"]
_LEAST_ALPHA = 1e-10


def rasterization(
    means: Tensor,
    quats: Tensor | None,
    scales: Tensor | None,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,  # noqa: N803 (gsplat's name)
    width: int,
    height: int,
    *,
    near_plane: float = 0.01,
    eps2d: float = 0.3,
    rasterize_mode: RasterizeMode = "classic",
    backgrounds: Tensor | None = None,
    render_mode: RenderMode = "RGB",
    covars: Tensor | None = None,
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Draw Gaussians in space by C cameras (Kerbl et al. 2023).

    Names, order, defaults and shapes are those of `gsplat.rasterization`; of its other options
    there is none, because not every backend has them. Everything is differentiable: means, quats,
    scales, covars, opacities, colours, backgrounds, viewmats (pose) and Ks (focal length). On a CPU
    pictures and gradients are the same bit for bit for any number of threads.

    Args:
        means: (N, 3) world units.
        quats: (N, 4) w x y z, of any length but zero; unused with covars.
        scales: (N, 3) standard deviations, world units; unused with covars.
        opacities: (N,) between 0 and 1.
        colors: (N, D), or (C, N, D) for colours that depend on the camera.
        viewmats: (C, 4, 4) camera from world, OpenCV axes: x right, y down, z forward.
        Ks: (C, 3, 3) pinhole matrices without skew, pixels; centres of pixels lie at +0.5.
        width: of the pictures, pixels.
        height: of the pictures, pixels.
        near_plane: what is nearer is not drawn, world units.
        eps2d: variance of the screen filter, pixels squared; that of a square pixel is 1 / 12.
        rasterize_mode: "antialiased" takes from the opacity what the filter adds to the area (Yu et
            al. 2024), "classic" does not.
        backgrounds: (C, D) colours behind; None is black.
        render_mode: "RGB+ED" appends the expected camera z, world units; "RGB+MD", which gsplat
            lacks, the median: that of the Gaussian behind which half of the light is gone, or of
            the last one; 0 where there is none. Of an edge between near and far it is one of both.
        covars: (N, 3, 3) covariances, world units squared, in the place of quats and scales.

    Returns:
        Pictures (C, H, W, D) or (C, H, W, D + 1), alphas (C, H, W, 1), and a dict of `means2d`
        (C, N, 2) in pixels, whose gradient can be retained, `width`, `height` and `n_cameras`.

    Raises:
        InputError: shapes that do not go together; "RGB+MD" of gsplat.
        DependencyError: on a GPU without gsplat.
    """
    check_inputs(
        means, quats, scales, opacities, colors, viewmats, Ks, (width, height), covars=covars
    )
    name = of_gaussians(means)
    if name == "gsplat":
        if render_mode == "RGB+MD":
            raise InputError(
                "rasterization: expected render_mode RGB or RGB+ED on a GPU, got RGB+MD, for which "
                "gsplat has no kernel; take RGB+ED there, or draw on the CPU"
            )
        # gsplat is an extra: it is looked for where it is used.
        from pcore.kernels.gsplat_gaussians import rasterization as by_gsplat

        return by_gsplat(
            means,
            quats,
            scales,
            opacities,
            colors,
            viewmats,
            Ks,
            width,
            height,
            near_plane=near_plane,
            eps2d=eps2d,
            rasterize_mode=rasterize_mode,
            backgrounds=backgrounds,
            render_mode=render_mode,
            covars=covars,
        )
    work, shapes = cpu_gaussians, gaussian_projection
    if name == "reference":
        work = shapes = reference_gaussians
    projected = shapes.project(
        means,
        _covariances(shapes, quats, scales, covars),
        viewmats,
        Ks,
        (width, height),
        near_plane=near_plane,
        eps2d=eps2d,
    )
    seen = opacities.expand_as(projected.shares)
    if rasterize_mode == "antialiased":
        seen = seen * projected.shares
    colors = colors.expand(len(viewmats), *colors.shape[-2:])
    if render_mode == "RGB+ED":
        colors = torch.cat([colors, projected.depths.unsqueeze(-1)], dim=-1)
    image, alpha, middle = work.blended(
        projected.means,
        projected.conics,
        seen,
        colors,
        projected.depths,
        (width, height),
        near_plane,
    )
    meta = {
        "means2d": projected.means,
        "width": width,
        "height": height,
        "n_cameras": len(viewmats),
    }
    if render_mode == "RGB+MD":
        # One more for -1. index_select adds gradients in one order, indexing by threads does not.
        known = torch.cat([projected.depths.flatten(), projected.depths.new_zeros(1)])
        depth = known.index_select(0, middle.flatten() % len(known)).view_as(alpha)
        image = torch.cat([image, depth.unsqueeze(-1)], dim=-1)
    return finished(image, alpha.unsqueeze(-1), backgrounds, render_mode), alpha[..., None], meta


def finished(
    image: Tensor, alpha: Tensor, backgrounds: Tensor | None, render_mode: RenderMode
) -> Tensor:
    """Put the background behind pictures (C, H, W, D) and turn sums of depths into means."""
    depth = None
    if render_mode != "RGB":
        image, depth = image[..., :-1], image[..., -1:]
    if depth is not None and render_mode == "RGB+ED":
        depth = depth / alpha.clamp_min(_LEAST_ALPHA)
    if backgrounds is not None:
        image = image + (1 - alpha) * backgrounds[:, None, None]
    return image if depth is None else torch.cat([image, depth], dim=-1)


def _covariances(
    shapes: ModuleType, quats: Tensor | None, scales: Tensor | None, covars: Tensor | None
) -> Any:
    """Covariances in the form that a module's `project` takes."""
    return shapes.entries_of(covars) if covars is not None else shapes.covariances_of(quats, scales)


def check_inputs(
    means: Tensor,
    quats: Tensor | None,
    scales: Tensor | None,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    intrinsics: Tensor,
    size: tuple[int, int],
    **instead: Tensor | None,
) -> None:
    """Raise InputError for shapes that do not go together.

    Args:
        means: as all others, see `rasterization`.
        quats: unused where `instead` is given, as are scales.
        scales: see there.
        opacities: see there.
        colors: see there.
        viewmats: see there.
        intrinsics: see there.
        size: width and height.
        **instead: what may stand in the place of quats and scales: `covars` (N, 3, 3) or `tangents`
            (N, 3, 2); one of them.
    """
    ((other, shape),) = instead.items()
    count, cameras = len(means), len(viewmats)
    if shape is None and (quats is None or scales is None):
        raise InputError(f"rasterization: expected quats and scales, or {other}; got neither")
    if min(size) < 1:
        raise InputError(f"rasterization: expected a positive size, got {size[0]} x {size[1]}")
    channels = colors.shape[-1] if colors.ndim else 0
    found: list[tuple[str, Tensor | None, Sequence[tuple[int, ...]]]] = [
        ("means", means, [(count, 3)]),
        ("opacities", opacities, [(count,)]),
        ("colors", colors, [(count, channels), (cameras, count, channels)]),
        ("viewmats", viewmats, [(cameras, 4, 4)]),
        ("Ks", intrinsics, [(cameras, 3, 3)]),
        (other, shape, [(count, 3, 3 if other == "covars" else 2)]),
    ]
    if shape is None:
        found += [("quats", quats, [(count, 4)]), ("scales", scales, [(count, 3)])]
    for name, tensor, allowed in found:
        if tensor is not None and tuple(tensor.shape) not in allowed:
            raise InputError(
                f"rasterization: expected {name} of shape "
                f"{' or '.join(map(str, allowed))}, got {tuple(tensor.shape)}"
            )
