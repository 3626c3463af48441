"""The nearest-to-ray search, ours against the paper's dense formula."""

from __future__ import annotations

from collections.abc import Iterator

from torch import Tensor

from benchmarks import dense, scenes
from benchmarks.measure import in_turns, peak_bytes
from benchmarks.metrics import Metric
from benchmarks.plan import Plan
from pcore.geometry.rays import RayBundle
from pcore.kernels.functional import nearest_to_rays

_DENSE_PAIRS = 20_000_000
"""Ray-point pairs that the dense formula is timed on; its time is scaled to all rays. Every ray
costs it the same, so that is no approximation."""


def measure_search(plan: Plan) -> Iterator[tuple[str, Metric]]:
    """Nearest-to-ray search over numbers of points, image sizes, k, and kinds of rays."""
    counts = (200, 600) if plan.quick else (5_000, 30_000, 100_000, 300_000)
    patch = scenes.patch(16, 80) if plan.quick else scenes.patch(160, 800)
    ours: dict[int, float] = {}
    for count in counts:
        name = f"search/patch/{count}"
        yield from _memory(
            name, plan, patch, scenes.cloud(count), 20, bar=64.0 if plan.bars else None
        )
        found = _compared(
            plan,
            patch,
            scenes.cloud(count),
            20,
            bar=400.0 if plan.bars and count == 30_000 else None,
        )
        ours[count] = found["seconds"].value
        yield from ((f"{name}/{key}", metric) for key, metric in found.items())
    if not plan.quick:
        growth = ours[300_000] / ours[30_000]
        yield (
            "search/patch/growth",
            Metric(value=growth, direction="lower", tolerance=0.4, bar=4.0 if plan.bars else None),
        )
    for name, rays, points, k, bar in _other_searches(plan):
        found = _compared(plan, rays, points, k, bar=bar)
        yield from ((f"search/{name}/{key}", metric) for key, metric in found.items())


def _other_searches(plan: Plan) -> Iterator[tuple[str, RayBundle, Tensor, int, float | None]]:
    side, count = (12, 300) if plan.quick else (64, 30_000)
    moved, points = scenes.near_surface(side, 5 * side, scenes.cloud(count))
    bar = 50.0 if plan.bars else None
    yield f"near_surface/{count}", moved, points, 20, bar
    for size, count, k in ((100, 6_000, 8), (100, 6_000, 64), (200, 30_000, 20)):
        if plan.quick:
            size, count = size // 10, count // 20
        yield f"image_{size}/{count}/k{k}", scenes.patch(size, size), scenes.cloud(count), k, None


def _compared(
    plan: Plan, rays: RayBundle, points: Tensor, k: int, *, bar: float | None
) -> dict[str, Metric]:
    """Ratio to the dense formula in one run, and the part of rays with the same neighbours."""
    origins, directions = (
        x.to(plan.device).contiguous() for x in (rays.flat().origins, rays.flat().directions)
    )
    points = points.to(plan.device)
    step = max(1, len(origins) * len(points) // _DENSE_PAIRS)
    some = (origins[::step].contiguous(), directions[::step].contiguous(), points, k)
    seconds = in_turns(
        {
            "ours": lambda: nearest_to_rays(origins, directions, points, k),
            "dense": lambda: dense.nearest_to_rays(*some),
        },
        plan.turns,
    )
    found = nearest_to_rays(origins, directions, points, k)[::step].sort(dim=-1).values
    expected = dense.nearest_to_rays(*some).sort(dim=-1).values
    same = float((found == expected).all(dim=-1).double().mean())
    mine = seconds["ours"]
    ratio = seconds["dense"] * len(origins) / len(some[0]) / mine
    return {
        # Machines and their other work differ; the ratio hardly does.
        "seconds": Metric(value=mine, direction="lower", tolerance=3.0, unit=" s"),
        "ratio": Metric(value=ratio, direction="higher", tolerance=0.4, bar=bar, unit="x"),
        # The k-th and the next point may be equally far within float32.
        "same_neighbours": Metric(value=same, direction="higher", tolerance=0.01),
    }


def _memory(
    name: str, plan: Plan, rays: RayBundle, points: Tensor, k: int, *, bar: float | None
) -> Iterator[tuple[str, Metric]]:
    """Yield the peak of the search's own memory, its result included."""
    flat = rays.flat()
    some = [x.to(plan.device).contiguous() for x in (flat.origins, flat.directions, points)]
    nearest_to_rays(some[0][:100], some[1][:100], some[2], k)
    peak = peak_bytes(lambda: nearest_to_rays(*some, k), plan.device)
    if peak is not None:
        value = peak / 1e6
        metric = Metric(value=value, direction="lower", tolerance=0.5, bar=bar, unit=" MB")
        yield f"{name}/memory", metric
