"""A training step and a picture of the `paper` sizes, ours against the paper's dense formulas."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import deepcopy
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
_KEPT = 0.5
"""Part of the neighbours with a weight that counts in a fast picture: so it is in trained models,
and the networks here are not trained."""


def measure_step(plan: Plan) -> Iterator[tuple[str, Metric]]:
    """Forward and backward of a patch: time against dense, gradients, and peak memory."""
    side, large, count = (8, 12, 200) if plan.quick else (64, 160, 30_000)
    papr, cloud = _papr(count, plan)
    rays = scenes.on_device(scenes.patch(side, 5 * side), plan.device)
    name, repeats = f"step/{side}x{side}/{count}", min(_REPEATS, plan.repeats)

    def ours() -> list[Tensor]:
        return _gradients(papr, cloud, lambda: papr(cloud, rays).rgb)

    def other(pairs: int) -> list[Tensor]:
        return _gradients(papr, cloud, lambda: dense.papr_picture(papr, cloud, rays, pairs=pairs))

    mine, slow = alternating(ours, lambda: other(dense.PAIRS), repeats)
    # As the original does it, the distances of all rays to all points at once; chunks are faster.
    whole = alternating(lambda: None, lambda: other(side * side * count), repeats)[1]
    yield f"{name}/seconds", Metric(value=mine, direction="lower", tolerance=3.0, unit=" s")
    yield f"{name}/ratio", _ratio(whole / mine, None if plan.quick else 4.0)
    yield f"{name}/ratio_in_chunks", _ratio(slow / mine, None)
    yield from _gradient_errors(name, papr, cloud, plan)
    if plan.device.type == "cpu":
        patch = scenes.patch(large, 5 * large)
        peak = peak_bytes(lambda: _gradients(papr, cloud, lambda: papr(cloud, patch).rgb))
        if peak is not None:
            yield (
                f"step/{large}x{large}/{count}/memory",
                Metric(
                    value=peak / 1e9,
                    direction="lower",
                    tolerance=0.3,
                    bar=None if plan.quick else 5.0,
                    unit=" GB",
                ),
            )


def _ratio(value: float, bar: float | None) -> Metric:
    return Metric(value=value, direction="higher", tolerance=0.3, bar=bar, unit="x")


def _gradients(papr: Papr, cloud: PointCloud, picture: Callable[[], Tensor]) -> list[Tensor]:
    """Gradients of a loss on the picture: points first, then networks."""
    leaves = [cloud.positions, cloud.features, cloud.influence, *papr.parameters()]
    return list(torch.autograd.grad((picture() - 0.3).square().mean(), leaves))


def _gradient_errors(
    name: str, papr: Papr, cloud: PointCloud, plan: Plan
) -> Iterator[tuple[str, Metric]]:
    """Error of gradients against float64 relative to the largest entry, ours and the dense one's.

    Of the worst parameter, of 999 entries in 1,000: a unit that lies on the kink of its ReLU may
    go either way in float32, which changes the gradient of a single point.
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
        ("ours", lambda: papr(cloud, rays).rgb),
        ("dense", lambda: dense.papr_picture(papr, cloud, rays)),
    ):
        found = _gradients(papr, cloud, picture)
        error = max(
            float((a - b).abs().flatten().quantile(0.999) / b.abs().max())
            for a, b in zip(found, exact, strict=True)
        )
        yield f"{name}/gradient_error/{kind}", Metric(value=error, direction="lower", tolerance=9.0)


def _papr(count: int, plan: Plan) -> tuple[Papr, PointCloud]:
    return scenes.papr(preset("paper").model, scenes.cloud(count), plan.device)


def measure_render(plan: Plan) -> Iterator[tuple[str, Metric]]:
    """A picture, exact and fast; the dense formula is timed on a part of the rays and scaled."""
    side, count, part = (16, 200, 8) if plan.quick else (200, 30_000, 64)
    papr, cloud = _papr(count, plan)
    camera, corner = scenes.camera(side), (side - part) // 2
    crop = scenes.on_device(camera.rays().crop(corner, corner, part, part), plan.device)
    sharp, kept = _sharpened(papr, cloud, crop)
    repeats, name = min(_REPEATS, plan.repeats), f"render/{side}x{side}/{count}"

    @torch.no_grad()
    def slow(pairs: int) -> Tensor:
        return dense.papr_picture(papr, cloud, crop, pairs=pairs)

    exact, part_in_chunks = alternating(
        lambda: render(papr, cloud, camera), lambda: slow(dense.PAIRS), repeats
    )
    fast, part_at_once = alternating(
        lambda: render(papr, sharp, camera, threshold=FAST_THRESHOLD),
        lambda: slow(part * part * count),
        repeats,
    )
    share = side**2 / part**2
    yield f"{name}/seconds", Metric(value=exact, direction="lower", tolerance=3.0, unit=" s")
    for kind, seconds, bar in (("exact", exact, 6.0), ("fast", fast, 12.0)):
        limit = None if plan.quick else bar
        yield f"{name}/{kind}/ratio", _ratio(share * part_at_once / seconds, limit)
        yield f"{name}/{kind}/ratio_in_chunks", _ratio(share * part_in_chunks / seconds, None)
    yield f"{name}/fast/kept", Metric(value=kept, direction="lower", tolerance=0.3)
    with torch.no_grad():
        error = float((papr(cloud, crop).rgb - slow(dense.PAIRS)).abs().max())
    yield f"{name}/exact/error", Metric(value=error, direction="lower", tolerance=9.0, bar=1e-4)


@torch.no_grad()
def _sharpened(papr: Papr, cloud: PointCloud, rays: RayBundle) -> tuple[PointCloud, float]:
    """Scale the influence until `--fast` keeps half of a ray's neighbours, as in trained models.

    Returns:
        The cloud, and the part of the neighbours that are kept.
    """
    kept, most = 1.0, 2**20 * float(cloud.influence.max())
    while kept > _KEPT and float(cloud.influence.max()) < most:
        cloud = replace(cloud, influence=1.25 * cloud.influence)
        weights = papr.attend(cloud, rays[::8, ::8].flat())[0].weights
        kept = float((weights >= FAST_THRESHOLD).double().mean())
    return cloud, kept
