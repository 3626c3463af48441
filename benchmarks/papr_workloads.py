"""A training step and a picture of the `paper` sizes, ours against the paper's dense formulas."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import torch
from torch import Tensor

from benchmarks import dense, scenes
from benchmarks.measure import alternating, peak_bytes
from benchmarks.metrics import Metric
from benchmarks.plan import Plan
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.model.papr import Papr
from pcore.model.render import FAST_THRESHOLD, render
from pcore.training.presets import preset

_REPEATS = 2
"""Turns that count; a dense step takes longer than whole searches."""
_SHARPNESS = 8.0
"""Influence of the points of the picture that is drawn fast. The networks are not trained: with
this, a ray's neighbours above the threshold are about half of all, as in trained models."""


def measure_step(plan: Plan) -> Iterator[tuple[str, Metric]]:
    """Forward and backward of a patch: time against dense, results, and peak memory."""
    side, count = (8, 200) if plan.quick else (64, 30_000)
    papr, cloud = scenes.papr(preset("paper").model, scenes.cloud(count), plan.device)
    rays = scenes.on_device(scenes.patch(side, 5 * side), plan.device)
    pairs = dense.PAIRS if plan.quick else side * side * count
    mine, others, gradients = _steps(papr, cloud, rays)
    ours, slow = alternating(mine, others, min(_REPEATS, plan.repeats))
    name = f"step/{side}x{side}/{count}"
    yield f"{name}/seconds", Metric(value=ours, direction="lower", tolerance=3.0, unit=" s")
    bar = None if plan.quick else 4.0
    yield (
        f"{name}/ratio",
        Metric(value=slow / ours, direction="higher", tolerance=0.3, bar=bar, unit="x"),
    )
    # As the original does it: the distances of all rays to all points at once.
    _, whole, _ = _steps(papr, cloud, rays, pairs)
    _, slow = alternating(mine, whole, min(_REPEATS, plan.repeats))
    yield (
        f"{name}/ratio_at_once",
        Metric(value=slow / ours, direction="higher", tolerance=0.3, unit="x"),
    )
    yield (
        f"{name}/gradient_error",
        Metric(value=gradients(), direction="lower", tolerance=9.0, bar=1e-3),
    )
    if plan.device.type == "cpu":
        side = 12 if plan.quick else 160
        larger, _, _ = _steps(papr, cloud, scenes.patch(side, 5 * side))
        peak = peak_bytes(larger)
        if peak is not None:
            value, bar = peak / 1e9, None if plan.quick else 5.0
            yield (
                f"step/{side}x{side}/{count}/memory",
                Metric(value=value, direction="lower", tolerance=0.3, bar=bar, unit=" GB"),
            )


def _steps(
    papr: Papr, cloud: PointCloud, rays: RayBundle, pairs: int = dense.PAIRS
) -> tuple[Callable[[], object], Callable[[], object], Callable[[], float]]:
    """Our step, the dense one, and the greatest relative difference of their gradients."""
    target = torch.rand(*rays.shape, 3, device=rays.origins.device)
    leaves = [cloud.positions, cloud.features, cloud.influence, *papr.parameters()]

    def step(picture: Callable[[], Tensor]) -> list[Tensor]:
        loss = (picture() - target).square().mean()
        return list(torch.autograd.grad(loss, leaves))

    def ours() -> list[Tensor]:
        return step(lambda: papr(cloud, rays).rgb)

    def other() -> list[Tensor]:
        return step(lambda: dense.papr_picture(papr, cloud, rays, pairs=pairs))

    def difference() -> float:
        return max(
            float((a - b).norm() / b.norm().clamp_min(1e-12))
            for a, b in zip(ours(), other(), strict=True)
        )

    return ours, other, difference


def measure_render(plan: Plan) -> Iterator[tuple[str, Metric]]:
    """A picture, exact and fast; the dense formula is timed on a part of the rays and scaled."""
    side, count, part = (16, 200, 8) if plan.quick else (200, 30_000, 64)
    papr, cloud = scenes.papr(preset("paper").model, scenes.cloud(count), plan.device)
    camera = scenes.camera(side)
    rays = scenes.on_device(camera.rays(), plan.device)
    corner = (side - part) // 2
    crop = rays.crop(corner, corner, part, part)
    share, repeats = side**2 / part**2, min(_REPEATS, plan.repeats)
    name = f"render/{side}x{side}/{count}"

    @torch.no_grad()
    def slow(pairs: int) -> Tensor:
        return dense.papr_picture(papr, cloud, crop, pairs=pairs)

    exact, other = alternating(
        lambda: render(papr, cloud, camera), lambda: slow(dense.PAIRS), repeats
    )
    _, whole = alternating(lambda: None, lambda: slow(part * part * count), repeats)
    sharp = replace(cloud, influence=_SHARPNESS * cloud.influence)
    fast, _ = alternating(
        lambda: render(papr, sharp, camera, threshold=FAST_THRESHOLD), lambda: None, repeats
    )
    yield f"{name}/seconds", Metric(value=exact, direction="lower", tolerance=3.0, unit=" s")
    for kind, seconds, bar in (("exact", exact, 6.0), ("fast", fast, 12.0)):
        for against, dense_seconds in (("ratio", other), ("ratio_at_once", whole)):
            yield (
                f"{name}/{kind}/{against}",
                Metric(
                    value=share * dense_seconds / seconds,
                    direction="higher",
                    tolerance=0.3,
                    bar=bar if against == "ratio" and not plan.quick else None,
                    unit="x",
                ),
            )
    yield from _errors(name, papr, cloud, sharp, crop, plan)


def _errors(
    name: str, papr: Papr, cloud: PointCloud, sharp: PointCloud, crop: RayBundle, plan: Plan
) -> Iterator[tuple[str, Metric]]:
    """How far the exact picture is from the dense one, and the fast one from the exact one."""
    with torch.no_grad():
        error = float((papr(cloud, crop).rgb - dense.papr_picture(papr, cloud, crop)).abs().max())
        exact, fast = (papr.attend(sharp, crop.flat(), t)[0] for t in (0.0, FAST_THRESHOLD))
        weights = exact.weights
        pictures = [
            papr.shade(one.features.unflatten(0, crop.shape), 1 - one.background.view(crop.shape))
            for one in (exact, fast)
        ]
    kept = float((weights >= FAST_THRESHOLD).sum(dim=1).double().mean())
    psnr = -10 * float(torch.log10((pictures[0] - pictures[1]).square().mean()))
    yield f"{name}/exact/error", Metric(value=error, direction="lower", tolerance=9.0, bar=1e-4)
    bar = None if plan.quick else 50.0
    yield (
        f"{name}/fast/psnr",
        Metric(value=psnr, direction="higher", tolerance=0.2, bar=bar, unit=" dB"),
    )
    yield f"{name}/fast/kept_of_20", Metric(value=kept, direction="lower", tolerance=0.3)
