"""How fast this machine trains on a scene: a few real steps at a few sizes, thrown away."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from dataclasses import replace

import torch

from pcore.data.scene import Scene, View
from pcore.gaussians.pinhole import view_matrices
from pcore.gaussians.render import PosedGaussians, render_views
from pcore.training.config import PretrainConfig
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.gaussian_fit import picture_losses
from pcore.training.gaussian_start import camera_distance, start_gaussians
from pcore.training.pace import Clock
from pcore.training.pretrain import begin, patch_losses
from pcore.training.reduced_view import Photo, reduced
from pcore.training.speed import Speed, speed_from
from pcore.training.time_plan import Photos
from pcore.training.trainable_gaussians import TrainableGaussians, trainable_gaussians

_VIEWS = 4
"""Views that are looked at: decoding large photos takes its time."""
_SIDE = 200
"""Pixels along the longer side of the larger pictures; half of it of the smaller ones."""
_NUMBERS = (4_000, 16_000)
"""Gaussians of the two objects."""
_OPACITY = 0.5
"""Of every Gaussian, as in the middle of a training."""
_RENDERED = "NeRF-Synthetic"
"""The layout whose photos are only divided by what divides their sides."""
_TURNS = 3
_SOLID = 0.5


def photos_of(scene: Scene) -> Photos:
    """What a plan asks of a scene's training photos, from a few of them."""
    views = scene.split("train")
    shown = _some(views)
    coverage = 1.0
    if all(view.has_alpha for view in shown):
        coverage = statistics.mean(float((view.alpha() > _SOLID).float().mean()) for view in shown)
    return Photos(
        width=max(view.camera.width for view in views),
        height=max(view.camera.height for view in views),
        count=len(views),
        coverage=max(coverage, 1e-3),
        any_factor=scene.layout != _RENDERED,
    )


def measured_speed(
    scene: Scene, config: GaussianConfig, device: str = "cpu", clock: Clock = time.perf_counter
) -> Speed:
    """Seconds of a step by pixels and Gaussians, from a dozen steps that are thrown away.

    Args:
        scene: its training views; a few are decoded.
        config: start, harmonics, loss.
        device: that will train.
        clock: tells the time.

    Raises:
        InputError: as `start_gaussians`.
    """
    where = torch.device(device)
    views = _some(scene.split("train"))
    longest = max(max(view.camera.width, view.camera.height) for view in views)
    fine = max(1, round(longest / _SIDE))
    samples: list[tuple[float, float, float]] = []
    for count in _NUMBERS:
        work = _prepared(scene, views, replace(config, points=count), where)
        for reduction in (fine, 2 * fine):
            photos = reduced(views, reduction)
            camera = photos[0].camera
            seconds = _step_seconds(work, photos, config, clock)
            samples.append((camera.width * camera.height, work.points, seconds))
    return speed_from(samples)


def papr_step_seconds(
    scene: Scene, config: PretrainConfig, device: str = "cpu", clock: Clock = time.perf_counter
) -> float:
    """Seconds of a step of PAPR, from a few that are thrown away; LPIPS is not counted.

    Args:
        scene: its training views; a few are decoded.
        config: architecture, patch, number of points.
        device: that will train.
        clock: tells the time.
    """
    views = _some(scene.split("train"))
    work = begin(scene, views, config, torch.device(device))
    took: list[float] = []
    for _ in range(_TURNS + 1):
        began = clock()
        patch_losses(work, views, config).total.backward()
        for group in work.optimizer.param_groups:
            group["lr"] = 0.0
        work.optimizer.step()
        work.optimizer.zero_grad(set_to_none=True)
        took.append(clock() - began)
    return statistics.median(took[1:])


def _some(views: Sequence[View]) -> Sequence[View]:
    return views[:: max(1, len(views) // _VIEWS)][:_VIEWS]


def _prepared(
    scene: Scene, views: Sequence[View], config: GaussianConfig, device: torch.device
) -> TrainableGaussians:
    start = start_gaussians(scene, views, config, torch.Generator().manual_seed(config.seed))
    start = replace(start, opacities=torch.full_like(start.opacities, _OPACITY))
    return trainable_gaussians(
        start.to(device),
        distance=camera_distance(scene),
        footprint=config.footprint,
        backdrop=config.background,
        seed=config.seed,
    )


def _step_seconds(
    work: TrainableGaussians, photos: Sequence[Photo], config: GaussianConfig, clock: Clock
) -> float:
    """Median of a few steps; the first one, which may compile, does not count."""
    took: list[float] = []
    like = work.raw["means"]
    color = torch.ones(3)
    for turn in range(_TURNS + 1):
        began = clock()
        shown = photos[turn % len(photos)]
        viewmat, intrinsics = view_matrices([shown.camera], like)
        found = render_views(
            PosedGaussians(gaussians=work.gaussians(config.degree)),
            viewmat,
            intrinsics,
            (shown.camera.width, shown.camera.height),
            footprint=config.footprint,
            depth=False,
            background=color.to(like),
        )
        photo = shown.rgba()[..., :3].to(like).unsqueeze(0)
        picture_losses(found.rgb, photo, config.ssim_weight).total.backward()
        # A rate of zero moves nothing and costs the same.
        for group in work.optimizer.param_groups:
            group["lr"] = 0.0
        work.optimizer.step()
        work.optimizer.zero_grad(set_to_none=True)
        took.append(clock() - began)
    return statistics.median(took[1:])
