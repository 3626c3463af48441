"""Gaussians that look like an object of neural points: for programs that draw nothing else.

They begin as flat pieces of the surface over the points, and the trainer of Gaussians fits them to
pictures of the object. An edit carries them as it carries the Gaussians of a run.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.meshing import box_of, cameras_around, map_of
from pcore.asset.picture_set import Named, save_picture_set, straight
from pcore.asset.posing import Edit
from pcore.capture.load import load_scene
from pcore.gaussians.carry import carried
from pcore.gaussians.covariance import quaternions
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint, PosedGaussians, render
from pcore.geometry.camera import Camera
from pcore.geometry.surfels import Surfels, known_normals
from pcore.render.image import Image
from pcore.training.events import Event, ValidationReport
from pcore.training.gaussian_config import DensityConfig, GaussianConfig
from pcore.training.gaussian_fit import fit_gaussians
from pcore.training.gaussian_start import mean_colors

_VIEWS = 60
_WIDE, _FLAT = 0.6, 0.1
"""Standard deviations at the start along the surface and across it, in spacings of the points."""
_OPACITY = 0.7
_CONSTANT = 0.28209479177387814
"""The harmonic of degree 0."""
_COMPARED = 6

Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedSplats:
    """Gaussians and how near they come.

    Attributes:
        gaussians: at rest, on the CPU.
        footprint: how they were fitted to meet pixels.
        psnr: dB, mean over pictures of the object that the fit did not see; None without any.
        cameras: that the pictures were taken from.
    """

    gaussians: Gaussians
    footprint: Footprint
    psnr: float | None
    cameras: tuple[Camera, ...]


def splats_of_points(
    asset: Asset,
    cameras: Sequence[Camera] | None = None,
    *,
    steps: int = 1200,
    progress: Progress | None = None,
) -> FittedSplats:
    """Fit Gaussians to the pictures of an object at rest.

    Args:
        asset: the object; one with surfels gives flat Gaussians to begin with.
        cameras: where to look from, those of its photos; at most 60 of them are taken. None looks
            from all around.
        steps: of the fit.
        progress: told (pictures and steps done, all of them).

    Raises:
        InputError: nothing is to be seen.
    """
    chosen = _spread(cameras or cameras_around(*box_of(asset.points)))
    total, found = len(chosen) + steps, list[float]()

    def tell(done: int) -> None:
        if progress is not None:
            progress(done, total)

    def listen(event: Event) -> None:
        if isinstance(event, ValidationReport):
            found.append(event.psnr)
        elif hasattr(event, "step"):
            tell(len(chosen) + event.step)

    named: Named = [(f"view_{number:03}", camera) for number, camera in enumerate(chosen)]
    with tempfile.TemporaryDirectory() as folder:
        save_picture_set(Path(folder), asset, None, named, progress=lambda done, _: tell(done))
        scene = load_scene(folder)
        count = len(asset)
        start = flat_gaussians(asset, mean_colors(asset.points.float(), scene.split("train")))
        config = GaussianConfig(
            steps=steps,
            points=count,
            density=DensityConfig(limit=2 * count),
            validate_every=steps,
            save_every=steps,
        )
        fitted = fit_gaussians(scene, config, start=start, listener=listen)
    return FittedSplats(
        gaussians=fitted.gaussians.to("cpu"),
        footprint=fitted.footprint,
        psnr=found[-1] if found else None,
        cameras=tuple(chosen),
    )


def flat_gaussians(asset: Asset, colors: Tensor) -> Gaussians:
    """Gaussians (N) on the surface over an object's points, across its normals flat.

    Args:
        asset: the object at rest; without surfels they are round.
        colors: (N, 3) in [0, 1]; the other harmonics, up to degree 3, are 0.
    """
    positions = asset.points.float()
    surfels = asset.content.surfels or Surfels.at_rest(
        positions, torch.zeros_like(positions), torch.zeros(len(positions))
    )
    normals, spacing = surfels.normals.float(), float(surfels.spacing)
    known = known_normals(normals)
    up = torch.where(known[:, None], normals, torch.tensor([0.0, 0.0, 1.0]))
    # The axis that is least along the normal cannot be parallel to it.
    side = torch.eye(3)[up.abs().argmin(dim=1)]
    first = torch.nn.functional.normalize(torch.linalg.cross(side, up), dim=1)
    axes = torch.stack([first, torch.linalg.cross(up, first), up], dim=-1)
    scales = torch.full((len(positions), 3), _WIDE * spacing)
    scales[:, 2] = torch.where(known, _FLAT, _WIDE) * spacing
    sh = torch.zeros(len(positions), 16, 3)
    sh[:, 0] = (colors - 0.5) / _CONSTANT
    return Gaussians(
        means=surfels.places.float(),
        quats=quaternions(axes),
        scales=scales,
        opacities=torch.full((len(positions),), _OPACITY),
        sh=sh,
    )


def edited_splats(
    asset: Asset, gaussians: Gaussians, edit: Edit | None, *, time: float | None = None
) -> Gaussians:
    """Carry Gaussians fitted to an object along with an edit of it, in double precision.

    Args:
        asset: the object, to whose points the edit is bound.
        gaussians: at rest.
        edit: see `Asset.pose`.
        time: for an edit file with keyframes.

    Raises:
        EditError: the edit is not valid, does not fit the points or folds space.
    """
    if edit is None:
        return gaussians
    deformation = map_of(asset, edit, time=time)
    means = gaussians.means.double()
    with torch.no_grad():
        positions, maps = deformation(means), deformation.jacobian(means)
    wide = gaussians.to(dtype=torch.float64)
    return carried(replace(wide, sh=gaussians.sh), positions, maps)


def likeness(
    asset: Asset,
    fitted: FittedSplats,
    gaussians: Gaussians,
    edit: Edit | None,
    *,
    time: float | None = None,
) -> float:
    """Return PSNR in dB of edited Gaussians against the edited object's own pictures, over white.

    The light is baked in on both sides, as in a file of Gaussians.
    """
    posed = asset.pose(edit, time=time, light="baked")
    step = max(1, len(fitted.cameras) // _COMPARED)
    cameras = fitted.cameras[::step][:_COMPARED]
    black, error = asset.over((0.0, 0.0, 0.0)), 0.0
    drawn = PosedGaussians(gaussians=gaussians.to(dtype=torch.float32))
    for camera in cameras:
        own = _on_white(black.render(posed, camera).cpu())
        with torch.no_grad():
            theirs = render(drawn, [camera], footprint=fitted.footprint).rgb[0]
        error += float((own - theirs.clamp(0, 1)).square().mean()) / len(cameras)
    return -10 * float(torch.tensor(max(error, 1e-12)).log10())


def _on_white(image: Image) -> Tensor:
    rgba = straight(image)
    return rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:]


def _spread(cameras: Sequence[Camera]) -> list[Camera]:
    return [cameras[k] for k in sorted({len(cameras) * k // _VIEWS for k in range(_VIEWS)})]
