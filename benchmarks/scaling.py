"""`python -m benchmarks scaling`: processor seconds and memory against the size of everything.

One size grows at a time, the others stay; printed are seconds, peak of memory, and of both the
exponent p of the growth between the two largest sizes and over all (least squares of logarithms).
Models are made, not trained: `scenes.py` for PAPR, Gaussians that cover the same surface.
"""

from __future__ import annotations

import argparse
import math
import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from benchmarks import scenes
from benchmarks.measure import machine, peak_bytes, seconds
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint, PosedGaussians, render
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.kernels.functional import nearest_to_rays
from pcore.model.papr import Papr
from pcore.render.picture import render as render_points
from pcore.training.presets import preset

POINTS = (5_000, 30_000, 100_000, 300_000, 1_000_000)
_CPU = torch.device("cpu")
Call = Callable[[], object]


@dataclass(frozen=True, kw_only=True)
class Series:
    """One thing that grows.

    Attributes:
        name: what is measured and what grows.
        sizes: of what grows.
        made: prepares one size; the call that it gives is measured.
    """

    name: str
    sizes: Sequence[int]
    made: Callable[[int], Call]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument(
        "--only", nargs="+", default=(), help="series whose names hold one of these"
    )
    parser.add_argument("--quick", action="store_true", help="two small sizes: only that it runs")
    parser.add_argument("--turns", type=int, default=2, help="the median counts, after one more")


def run(wanted: argparse.Namespace) -> int:
    """Measure and print a table in Markdown; return the exit status."""
    torch.set_num_threads(1)
    print(machine(_CPU, 1))
    print("| what grows | sizes | seconds | GB | p, last two | p, all | p of GB, last two | all |")
    print("|---|---|---|---|---|---|---|---|")
    for one in series():
        if not wanted.only or any(word in one.name for word in wanted.only):
            sizes = tuple(one.sizes[:2]) if wanted.quick else one.sizes
            print(row(one, sizes, wanted.turns), flush=True)
    return 0


def row(one: Series, sizes: Sequence[int], turns: int) -> str:
    """Measure a series; one line of the table."""
    times: list[float] = []
    peaks: list[float] = []
    for size in sizes:
        call = one.made(size)
        found = [seconds(call) for _ in range(turns + 1)][1:]
        times.append(statistics.median(found))
        peaks.append((peak_bytes(call, _CPU) or math.nan) / 1e9)
    cells = [
        one.name,
        ", ".join(f"{size:,}" for size in sizes),
        ", ".join(f"{value:.3g}" for value in times),
        ", ".join(f"{value:.2g}" for value in peaks),
        *(f"{exponent(sizes[k:], values[k:]):.2f}" for values in (times, peaks) for k in (-2, 0)),
    ]
    return f"| {' | '.join(cells)} |"


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """The p of values ~ sizes^p, least squares of the logarithms."""
    x, y = [math.log(size) for size in sizes], [math.log(value) for value in values]
    return statistics.linear_regression(x, y).slope


def series() -> Iterator[Series]:
    """All of them, PAPR first."""
    yield Series(name="PAPR, search of 64 x 64 rays: points", sizes=POINTS, made=_search)
    yield Series(name="PAPR, picture of 128 x 128: points", sizes=POINTS, made=_papr_points)
    yield Series(
        name="PAPR, step of 64 x 64 rays: points",
        sizes=POINTS[:4],
        made=lambda n: _step(*_papr(n), 64),
    )
    yield Series(
        name="PAPR, picture of 30,000 points: pixels of a side",
        sizes=(64, 128, 256, 512),
        made=lambda side: _papr_picture(*_papr(), side),
    )
    yield Series(
        name="PAPR, step of 30,000 points: rays of a side",
        sizes=(32, 64, 128),
        made=lambda side: _step(*_papr(), side),
    )
    yield Series(
        name="PAPR, picture of 96 x 96: rays of a pixel",
        sizes=(1, 4, 9, 16),
        made=lambda count: _papr_picture(*_papr(), 96, samples=count),
    )
    yield Series(
        name="PAPR, picture of 128 x 128: neighbours", sizes=(5, 10, 20, 40), made=_papr_neighbours
    )
    yield Series(name="Gaussians, picture of 128 x 128: number", sizes=POINTS, made=_splats)
    yield Series(
        name="Gaussians, step of 128 x 128: number",
        sizes=POINTS[:4],
        made=lambda n: _splats(n, step=True),
    )
    yield Series(
        name="Gaussians, picture of 30,000: pixels of a side",
        sizes=(128, 256, 512, 1024),
        made=lambda side: _splats(30_000, side),
    )
    yield Series(
        name="Gaussians, step of 30,000: pixels of a side",
        sizes=(128, 256, 512),
        made=lambda side: _splats(30_000, side, step=True),
    )


def _search(count: int) -> Call:
    points, rays = scenes.cloud(count), scenes.patch(64, 400).flat()
    return lambda: nearest_to_rays(rays.origins, rays.directions, points, 20)


def _papr(count: int = 30_000, neighbours: int | None = None) -> tuple[Papr, PointCloud]:
    model = preset("tiny").model
    if neighbours is not None:
        model = replace(model, neighbours=neighbours)
    return scenes.papr(model, scenes.cloud(count), _CPU)


def _papr_points(count: int) -> Call:
    return _papr_picture(*_papr(count), 128)


def _papr_neighbours(count: int) -> Call:
    return _papr_picture(*_papr(neighbours=count), 128)


def _papr_picture(papr: Papr, cloud: PointCloud, side: int, *, samples: int = 1) -> Call:
    camera = scenes.camera(side)

    @torch.no_grad()
    def call() -> object:
        return render_points(papr, PosedCloud.at_rest(cloud), camera, samples=samples)

    return call


def _step(papr: Papr, cloud: PointCloud, side: int) -> Call:
    rays = scenes.patch(side, 5 * side)
    leaves = [cloud.positions, cloud.features, cloud.influence, *papr.parameters()]

    def call() -> object:
        loss = (scenes.training_colours(papr, cloud, rays) - 0.3).square().mean()
        return torch.autograd.grad(loss, leaves, allow_unused=True)

    return call


def _splats(count: int, side: int = 128, *, step: bool = False) -> Call:
    """Gaussians twice as wide as their share of the surface, which is about 5 square units."""
    generator = torch.Generator().manual_seed(0)
    width = 2 * math.sqrt(5 / count / math.pi)
    found = Gaussians(
        means=scenes.cloud(count),
        quats=torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=-1),
        scales=width * torch.tensor([1.0, 1.0, 0.2]).expand(count, 3),
        opacities=torch.full((count,), 0.5),
        sh=0.3 * torch.randn(count, 16, 3, generator=generator),
    )
    camera = scenes.camera(side)

    def draw(gaussians: Gaussians) -> Tensor:
        posed = PosedGaussians(gaussians=gaussians)
        return render(posed, [camera], footprint=Footprint(), background=torch.ones(3)).rgb

    def picture() -> object:
        with torch.no_grad():
            return draw(found)

    def whole_step() -> object:
        leaves = found.each(lambda tensor: tensor.detach().clone().requires_grad_())
        draw(leaves).square().mean().backward()
        return leaves

    return whole_step if step else picture
