"""How fast this machine trains on a scene: a few real steps at a few sizes, thrown away."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import TypeVar

import torch
from torch import Tensor
from torch.autograd.graph import saved_tensors_hooks

from pcore.data.scene import Scene, View
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.pinhole import view_matrices
from pcore.gaussians.render import PosedGaussians, render_views
from pcore.metrics.trunks import TRUNKS
from pcore.training.config import PretrainConfig
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.gaussian_fit import picture_losses
from pcore.training.gaussian_start import camera_distance, start_gaussians
from pcore.training.near_origin import near_origin
from pcore.training.pace import Clock
from pcore.training.pretrain import begin, patch_losses
from pcore.training.reduced_view import Photo, reduced
from pcore.training.speed import Speed, speed_from
from pcore.training.time_plan import Photos
from pcore.training.trainable_gaussians import TrainableGaussians, trainable_gaussians

Decoded = TypeVar("Decoded", bound=Photo)

_VIEWS = 4
"""Views that are looked at: decoding large photos takes its time."""
_SIDE = 200
"""Pixels along the longer side of the larger pictures; half of it of the smaller ones."""
_START, _PARTS = 4_000, (1, 4)
"""Gaussians of a start, which is made once, and into how many parts each of them is taken: finding
where photos agree costs more than all the steps."""
_OPACITY = 0.5
"""Of every Gaussian, as in the middle of a training."""
_RENDERED = "NeRF-Synthetic"
"""The layout whose photos are only divided by what divides their sides."""
_TURNS = 3
_PATCHES = 10
"""Steps of PAPR with a cut-off and masks: patches that hold no point cost next to nothing."""
_ALIKE, _EVEN = 2, 1.25
"""So many steps that take the same but for so much are not repeated."""
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
    scene, origin = near_origin(scene)
    views = _some(scene.split("train"))
    longest = max(max(view.camera.width, view.camera.height) for view in views)
    fine = max(1, round(longest / _SIDE))
    samples: list[tuple[float, float, float]] = []
    generator = torch.Generator().manual_seed(config.seed)
    start = start_gaussians(scene, views, replace(config, points=_START), generator, origin)
    for parts in _PARTS:
        work = _prepared(scene, _in_parts(start, parts, generator), config, where)
        for reduction in (fine, 2 * fine):
            photos = _decoded(reduced(views, reduction))
            camera = photos[0].camera
            seconds = _step_seconds(work, photos, config, clock)
            samples.append((camera.width * camera.height, work.points, seconds))
    return speed_from(samples)


@dataclass(frozen=True, kw_only=True)
class StepCost:
    """What a training step takes.

    Attributes:
        seconds: of the clock that was read.
        memory: bytes that its gradients keep.
    """

    seconds: float
    memory: float


def papr_step(
    scene: Scene, config: PretrainConfig, device: str = "cpu", clock: Clock = time.perf_counter
) -> StepCost:
    """Cost of a step of PAPR, from a few that are thrown away.

    LPIPS is timed on a trunk of random weights, which costs what one of trained weights does.
    Points of a grid spread until nearly every ray meets some: the time is the mean of both ends,
    the memory that of the last.

    Args:
        scene: its training views; a few are decoded.
        config: architecture, patch, number of points.
        device: that will train.
        clock: tells the time.
    """
    cost = _timed_step(scene, config, device, clock)
    if not spreads(config):
        return cost
    everywhere = replace(config, model=replace(config.model, cutoff=None))
    met = _timed_step(scene, everywhere, device, clock)
    return StepCost(seconds=0.5 * (cost.seconds + met.seconds), memory=met.memory)


def spreads(config: PretrainConfig) -> bool:
    """Whether points of PAPR spread while it is trained: on a grid few rays meet any at first."""
    return config.start == "grid" and config.model.cutoff is not None


def _timed_step(scene: Scene, config: PretrainConfig, device: str, clock: Clock) -> StepCost:
    scene, origin = near_origin(scene)
    views = _decoded(_some(scene.split("train")))
    where = torch.device(device)
    work = begin(scene, views, config, where, origin)
    took: list[float] = []
    kept: dict[int, int] = {}
    uneven = config.model.cutoff is not None and all(view.has_alpha for view in views)
    turns = _PATCHES if uneven else _TURNS
    for turn in range(turns + 1):
        began = clock()
        # The first step does not count in time; so its gradients can be looked at.
        with _kept_for_gradients(kept) if turn == 0 else nullcontext():
            loss = patch_losses(work, views, config).total
        loss.backward()
        for group in work.optimizer.param_groups:
            group["lr"] = 0.0
        work.optimizer.step()
        work.optimizer.zero_grad(set_to_none=True)
        took.append(clock() - began)
        if turn == (_TURNS if uneven else _ALIKE) and max(took[1:]) < _EVEN * min(took[1:]):
            break  # More steps say the same.
    seconds = statistics.mean(took[1:])
    if config.lpips_weight > 0:
        seconds += _lpips_seconds(config, where, clock)
    return StepCost(seconds=seconds, memory=float(sum(kept.values())))


def _kept_for_gradients(kept: dict[int, int]) -> AbstractContextManager[None]:
    """Write the bytes of every storage that a forward pass saves into `kept`, by its address."""

    def note(tensor: Tensor) -> Tensor:
        storage = tensor.untyped_storage()
        kept[storage.data_ptr()] = storage.nbytes()
        return tensor

    return saved_tensors_hooks(note, lambda tensor: tensor)


def _lpips_seconds(config: PretrainConfig, device: torch.device, clock: Clock) -> float:
    """Of the loss on the patches of a step: two pictures through the trunk, one of them back."""
    with torch.random.fork_rng(devices=[]):
        trunk = TRUNKS[config.lpips_trunk].build().to(device).requires_grad_(requires_grad=False)
    side = max(config.patch.side, TRUNKS[config.lpips_trunk].smallest)
    took: list[float] = []
    for _ in range(2):
        began = clock()
        shown = torch.full((1, 3, side, side), 0.5, device=device, requires_grad=True)
        trunk(shown.detach())
        trunk(shown).square().mean().backward()
        took.append(clock() - began)
    return config.patch.views * took[-1]


def _some(views: Sequence[View]) -> Sequence[View]:
    return views[:: max(1, len(views) // _VIEWS)][:_VIEWS]


def _decoded(photos: Sequence[Decoded]) -> Sequence[Decoded]:
    """The photos, kept in memory now: a training decodes each of them once, and not in a step."""
    for photo in photos:
        photo.rgba()
        photo.valid()
    return photos


def _in_parts(start: Gaussians, parts: int, generator: torch.Generator) -> Gaussians:
    """Every Gaussian in parts inside of it that cover as much of a surface as it did."""
    many = start.each(lambda rows: rows.repeat_interleave(parts, dim=0))
    apart = torch.randn(many.means.shape, generator=generator) * (parts > 1)
    return replace(
        many, means=many.means + apart * many.scales, scales=many.scales / math.sqrt(parts)
    )


def _prepared(
    scene: Scene, start: Gaussians, config: GaussianConfig, device: torch.device
) -> TrainableGaussians:
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
