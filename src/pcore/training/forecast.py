"""What a training of a scene will take and give, before it begins."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from pcore.data.scene import Scene, View
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import PosedGaussians, render_views, view_matrices
from pcore.training.config import PretrainConfig
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.presets import gaussian_preset, preset
from pcore.training.ssim import ssim
from pcore.training.trainable_gaussians import photo_on, trainable_gaussians

_TRIES = 2
_BASE_MEMORY = 0.7e9
"""Bytes of a training without photos: measured with 10,000 Gaussians."""
_PAPR_STEP, _WORKLOAD = 0.33, 0.065
"""Processor seconds of a step of PAPR `tiny` (lego and chair at 100 x 100), and of `_workload`, on
the machine that the figures of docs/research/quality.md are from."""
_PER_STEP = 1.15
"""A whole training over its steps: validation, saving and the light."""


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """One way to train a scene.

    Attributes:
        model: "gaussians" or "papr".
        preset: its settings.
        seconds: of one processor core; None where nothing is known.
        memory: bytes at the most; None where nothing is known.
        quality: what such trainings gave elsewhere, for people.
        how: how the time was predicted, for people.
    """

    model: str
    preset: str
    seconds: float | None
    memory: float | None
    quality: str
    how: str


def forecasts(scene: Scene) -> tuple[Forecast, ...]:
    """Predict trainings of a scene by every kind of object and preset on this machine.

    Args:
        scene: with its region; a few of its training views are drawn.
    """
    views = scene.split("train")
    masked = all(view.has_alpha for view in views)
    photos = sum(view.camera.width * view.camera.height for view in views) * 16.0
    memory = _BASE_MEMORY + min(photos, 2.0 * 1024**3)
    plain = (
        "34 to 37 dB of the object on rendered ones of 100 x 100, 25 to 30 dB on masked photos"
        if masked
        else "27 to 33 dB of the whole picture on photos with background"
    )
    tiny = gaussian_preset("tiny")
    unknown = "for a GPU; nothing was measured on one"
    return (
        Forecast(
            model="gaussians",
            preset="tiny",
            seconds=_gaussian_seconds(views, scene, tiny),
            memory=memory,
            quality=plain,
            how=f"{2 * _TRIES} steps timed now, with {tiny.points:,} and {tiny.density.limit:,} "
            "Gaussians",
        ),
        Forecast(
            model="papr",
            preset="tiny",
            seconds=_papr_seconds(preset("tiny")),
            memory=memory,
            quality="30 to 32 dB of the object on rendered ones of 100 x 100"
            if masked
            else "17 to 20 dB with background: prefer Gaussians",
            how="recorded time of a step, scaled by a piece of work timed now",
        ),
        Forecast(
            model="gaussians", preset="fast", seconds=None, memory=None, quality="", how=unknown
        ),
        Forecast(
            model="papr", preset="fast, paper", seconds=None, memory=None, quality="", how=unknown
        ),
    )


def _gaussian_seconds(views: Sequence[View], scene: Scene, config: GaussianConfig) -> float:
    """Processor seconds: half of the steps while the number grows, half with all."""
    few = _step_seconds(views, scene, config, config.points)
    many = _step_seconds(views, scene, config, config.density.limit)
    return _PER_STEP * config.steps * (0.25 * few + 0.75 * many)


def _step_seconds(views: Sequence[View], scene: Scene, config: GaussianConfig, count: int) -> float:
    """Processor seconds of one step with so many Gaussians in the region."""
    generator = torch.Generator().manual_seed(config.seed)
    directions = torch.randn(count, 3, generator=generator)
    spread = 0.6 * scene.radius
    places = scene.center + spread * directions / directions.norm(dim=-1, keepdim=True)
    quats = torch.zeros(count, 4)
    quats[:, 0] = 1.0
    work = trainable_gaussians(
        Gaussians(
            means=places,
            quats=quats,
            scales=torch.full((count, 3), 2.0 * spread / count**0.5),
            opacities=torch.full((count,), 0.5),
            sh=torch.zeros(count, (config.degree + 1) ** 2, 3),
        ),
        distance=1.0,
        footprint=config.footprint,
        backdrop=config.background,
        seed=config.seed,
    )
    optimizer = torch.optim.Adam(list(work.raw.values()))
    taken: list[float] = []
    for step in range(_TRIES + 1):
        view = views[(step * len(views)) // (_TRIES + 1)]
        photo = photo_on(view, torch.ones(3), torch.device("cpu"))
        began = time.process_time()
        matrices = view_matrices([view.camera], work.raw["means"])
        size = (view.camera.width, view.camera.height)
        posed = PosedGaussians(gaussians=work.gaussians(config.degree))
        shown = render_views(posed, *matrices, size, footprint=config.footprint)
        loss = (shown.rgb - photo).abs().mean() + 1 - ssim(shown.rgb, photo)
        optimizer.zero_grad()
        loss.backward()  # pyright: ignore[reportUnknownMemberType]
        optimizer.step()
        taken.append(time.process_time() - began)
    return min(taken[1:])  # The first one compiles.


def _papr_seconds(config: PretrainConfig) -> float:
    return _PER_STEP * config.steps * _PAPR_STEP * _workload() / _WORKLOAD


def _workload() -> float:
    """Processor seconds of a fixed piece of work like that of small networks."""
    generator = torch.Generator().manual_seed(0)
    rows = torch.randn(40_000, 64, generator=generator)
    weights = torch.randn(64, 64, generator=generator) / 8
    best = float("inf")
    for _ in range(3):
        began = time.process_time()
        found = rows
        for _ in range(6):
            found = torch.relu(found @ weights)
        best = min(best, time.process_time() - began)
    return best
