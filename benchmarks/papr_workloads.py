"""A training step and a picture of the `paper` sizes, ours against the paper's dense formulas."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import replace

import torch
from torch import Tensor

from benchmarks import dense, scenes
from benchmarks.attention_workload import AT_ONCE, compared
from benchmarks.measure import in_turns, peak_bytes
from benchmarks.metrics import Metric
from benchmarks.plan import Plan
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.model.papr import Papr
from pcore.render.picture import FAST_THRESHOLD
from pcore.render.trace import trace
from pcore.training.presets import preset

_KEPT = 0.5
"""Part of the neighbours with a weight that counts in a fast picture: so it is in trained models,
and the networks here are not trained."""
_LEAST_PSNR = 50.0
"""Decibels against the exact picture that a fast one is to have."""


def measure_step(plan: Plan) -> Iterator[tuple[str, Metric]]:
    """Forward and backward of a patch: time against dense, gradients, and peak memory."""
    sizes = [(64, 30_000)]
    if plan.whole:
        sizes += [(32, 5_000), (32, 30_000), (32, 100_000), (32, 300_000)]
    for side, count in [(8, 200)] if plan.quick else sizes:
        papr, cloud = _papr(count, plan)
        name, bar = (
            f"step/{side}x{side}/{count}",
            4.0 if plan.bars and (side, count) == (64, 30_000) else None,
        )
        found = compared(in_turns(_steps(papr, cloud, side, plan), plan.long_turns), bar=bar)
        yield from ((f"{name}/{key}", metric) for key, metric in found.items())
        yield from _gradient_errors(name, papr, cloud, plan)
    side, count = (12, 200) if plan.quick else (160, 30_000)
    papr, cloud = _papr(count, plan)
    rays = scenes.on_device(scenes.patch(side, 5 * side), plan.device)
    peak = peak_bytes(
        lambda: _gradients(papr, cloud, lambda: scenes.training_colours(papr, cloud, rays)),
        plan.device,
    )
    yield from _memory(f"step/{side}x{side}/{count}", peak, 5.0 if plan.bars else None)


def _steps(
    papr: Papr, cloud: PointCloud, side: int, plan: Plan
) -> dict[str, Callable[[], list[Tensor]]]:
    rays = scenes.on_device(scenes.patch(side, 5 * side), plan.device)

    def other(pairs: int) -> list[Tensor]:
        return _gradients(papr, cloud, lambda: dense.papr_picture(papr, cloud, rays, pairs=pairs))

    ways = {
        "ours": lambda: _gradients(papr, cloud, lambda: scenes.training_colours(papr, cloud, rays)),
        "chunks": lambda: other(dense.PAIRS),
    }
    pairs = side**2 * len(cloud)
    return ways | ({"once": lambda: other(pairs)} if pairs <= AT_ONCE else {})


def _memory(name: str, peak: int | None, bar: float | None) -> Iterator[tuple[str, Metric]]:
    if peak is not None:
        value = peak / 1e9
        metric = Metric(value=value, direction="lower", tolerance=0.3, bar=bar, unit=" GB")
        yield f"{name}/memory", metric


def _gradients(papr: Papr, cloud: PointCloud, picture: Callable[[], Tensor]) -> list[Tensor]:
    """Gradients of a loss on the picture: points first, then networks."""
    leaves = [cloud.positions, cloud.features, cloud.influence, *papr.parameters()]
    return list(torch.autograd.grad((picture() - 0.3).square().mean(), leaves))


def _gradient_errors(
    name: str, papr: Papr, cloud: PointCloud, plan: Plan
) -> Iterator[tuple[str, Metric]]:
    """Error of gradients against float64 relative to the largest entry, ours and the dense one's.

    Of the worst parameter, of 999 entries in 1,000: a unit that lies on the kink of its ReLU may
    go either way in float32, which changes the gradient of a single point. That is a share of
    1,000 only of sizes that count, so others promise nothing.
    """
    rays = scenes.on_device(scenes.patch(8, 40), plan.device)
    exact_papr, exact_rays = deepcopy(papr).double(), scenes.doubled(rays)
    exact_cloud = PointCloud.from_tensors(
        {
            key: getattr(cloud, key).detach().double().requires_grad_()
            for key in ("positions", "features", "influence")
        }
    )
    exact = _gradients(
        exact_papr, exact_cloud, lambda: dense.papr_picture(exact_papr, exact_cloud, exact_rays)
    )
    for kind, picture in (
        ("ours", lambda: scenes.training_colours(papr, cloud, rays)),
        ("dense", lambda: dense.papr_picture(papr, cloud, rays)),
    ):
        found = _gradients(papr, cloud, picture)
        error = max(
            float((a - b).abs().flatten().quantile(0.999) / b.abs().max())
            for a, b in zip(found, exact, strict=True)
        )
        yield (
            f"{name}/gradient_error/{kind}",
            Metric(value=error, direction="lower", tolerance=9.0, bar=None if plan.quick else 1e-3),
        )


def _papr(count: int, plan: Plan) -> tuple[Papr, PointCloud]:
    return scenes.papr(preset("paper").model, scenes.cloud(count), plan.device)


def measure_render(plan: Plan) -> Iterator[tuple[str, Metric]]:
    """Pictures, exact and fast; the dense formula is timed on a part of the rays and scaled."""
    sizes = [(200, 30_000)]
    if plan.whole:
        sizes += [(100, 5_000), (100, 100_000), (100, 300_000), (400, 30_000)]
    for side, count in [(16, 200)] if plan.quick else sizes:
        barred = plan.bars and (side, count) == (200, 30_000)
        found = _pictures(side, count, 8 if plan.quick else 64, plan, barred=barred)
        yield from ((f"render/{side}x{side}/{count}/{key}", metric) for key, metric in found)


def _pictures(
    side: int, count: int, part: int, plan: Plan, *, barred: bool
) -> Iterator[tuple[str, Metric]]:
    papr, cloud = _papr(count, plan)
    camera, corner = scenes.camera(side), (side - part) // 2
    crop = scenes.on_device(camera.rays().crop(corner, corner, part, part), plan.device)
    sharp, kept = sharpened(papr, cloud, crop)

    @torch.no_grad()
    def slow(pairs: int) -> Tensor:
        return dense.papr_picture(papr, cloud, crop, pairs=pairs)

    ways: dict[str, Callable[[], object]] = {
        "exact": lambda: scenes.picture(papr, cloud, camera),
        "fast": lambda: scenes.picture(papr, sharp, camera, FAST_THRESHOLD),
        "chunks": lambda: slow(dense.PAIRS),
    }
    if part**2 * count <= AT_ONCE:
        ways["once"] = lambda: slow(part**2 * count)
    seconds = in_turns(ways, plan.long_turns)
    for kind, bar in (("exact", 6.0), ("fast", 12.0)):
        found = compared(
            seconds | {"ours": seconds[kind]},
            bar=bar if barred else None,
            share=side**2 / part**2,
        )
        yield from ((f"{kind}/{key}", metric) for key, metric in found.items())
    yield "fast/kept", Metric(value=kept, direction="lower", tolerance=0.3)
    yield "fast/psnr", fast_error(papr, sharp, camera)
    yield from _memory("exact", peak_bytes(ways["exact"], plan.device), None)
    with torch.no_grad():
        error = float((scenes.training_colours(papr, cloud, crop) - slow(dense.PAIRS)).abs().max())
    yield "exact/error", Metric(value=error, direction="lower", tolerance=9.0, bar=1e-4)


def fast_error(papr: Papr, cloud: PointCloud, camera: Camera) -> Metric:
    """PSNR of the fast picture against the exact one of the same model, dB.

    The peak is the exact picture's own range: colours of untrained networks do not fill [0, 1].
    """
    exact = scenes.picture(papr, cloud, camera)
    fast = scenes.picture(papr, cloud, camera, FAST_THRESHOLD)
    peak = float(exact.max() - exact.min())
    error = float((fast - exact).square().mean().clamp_min(1e-12 * peak**2))
    return Metric(
        value=10 * math.log10(peak**2 / error),
        direction="higher",
        tolerance=0.1,
        bar=_LEAST_PSNR,
        unit=" dB",
    )


@torch.no_grad()
def sharpened(papr: Papr, cloud: PointCloud, rays: RayBundle) -> tuple[PointCloud, float]:
    """Scale the influence until `--fast` keeps half of a ray's neighbours, as in trained models.

    Returns:
        The cloud, and the part of the neighbours that are kept.
    """
    kept, most = 1.0, 2**20 * float(cloud.influence.max())
    while kept > _KEPT and float(cloud.influence.max()) < most:
        cloud = replace(cloud, influence=1.25 * cloud.influence)
        weights = trace(papr, PosedCloud.at_rest(cloud), rays[::8, ::8]).weights
        kept = float((weights >= FAST_THRESHOLD).double().mean())
    return cloud, kept
