"""Proximity attention, search included, against the paper's dense formulas."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from benchmarks import dense, scenes
from benchmarks.measure import in_turns
from benchmarks.metrics import Metric
from benchmarks.plan import Plan
from pcore.geometry.posed import PosedCloud
from pcore.render.trace import trace
from pcore.training.presets import preset

AT_ONCE = 64 * 64 * 30_000
"""Ray-point pairs up to which the dense formula also takes all at once, as the original does."""


@dataclass(frozen=True, kw_only=True)
class Size:
    """A patch of side x side rays that look at so many points, k neighbours each."""

    side: int = 32
    count: int = 30_000
    k: int = 20

    @property
    def name(self) -> str:
        """As it appears in the names of metrics."""
        return f"{self.side}x{self.side}/{self.count}" + (f"/k{self.k}" if self.k != 20 else "")


BARRED = Size()
MATRIX = (
    *(Size(count=count) for count in (5_000, 100_000, 300_000)),
    *(Size(side=side) for side in (16, 64)),
    *(Size(k=k) for k in (8, 64)),
)


def measure_attention(plan: Plan) -> Iterator[tuple[str, Metric]]:
    """Forward alone, and forward and backward, of features and background."""
    sizes = (Size(side=8, count=200),) if plan.quick else (BARRED, *(MATRIX if plan.whole else ()))
    for size in sizes:
        for kind, calls in _calls(size, plan):
            found = in_turns(calls, plan.long_turns)
            yield from (
                (f"attention/{size.name}/{kind}/{key}", metric)
                for key, metric in compared(found).items()
            )


def _calls(size: Size, plan: Plan) -> Iterator[tuple[str, dict[str, Callable[[], object]]]]:
    model = replace(preset("paper").model, neighbours=size.k)
    papr, cloud = scenes.papr(model, scenes.cloud(size.count), plan.device)
    rays = scenes.on_device(scenes.patch(size.side, 5 * size.side).flat(), plan.device)
    leaves = [cloud.positions, cloud.features, cloud.influence, *papr.attention.parameters()]

    def ours() -> Tensor:
        found = trace(papr, PosedCloud.at_rest(cloud), rays, stop_encoding=True)
        return found.features.square().mean() + found.background.mean()

    def other(pairs: int) -> Tensor:
        features, background = dense.attend(papr, cloud, rays, pairs)
        return features.square().mean() + background.mean()

    ways: dict[str, Callable[[], Tensor]] = {"ours": ours, "chunks": lambda: other(dense.PAIRS)}
    if size.side**2 * size.count <= AT_ONCE:
        ways["once"] = lambda: other(size.side**2 * size.count)
    yield "forward", {name: torch.no_grad()(way) for name, way in ways.items()}
    yield (
        "both",
        {
            name: lambda way=way: torch.autograd.grad(way(), leaves, allow_unused=True)
            for name, way in ways.items()
        },
    )


def compared(
    seconds: dict[str, float], *, bar: float | None = None, share: float = 1.0
) -> dict[str, Metric]:
    """Time of `ours` and its ratios to the dense formula `once` and in `chunks`.

    Args:
        seconds: of calls that took turns.
        bar: of the ratio to the dense formula at once, the original's way.
        share: how much more than the dense formula did ours did.
    """
    mine = seconds["ours"]
    found = {"seconds": Metric(value=mine, direction="lower", tolerance=3.0, unit=" s")}
    # The original makes all distances at once; chunks are faster on a CPU.
    for way, name, promised in (("once", "ratio", bar), ("chunks", "ratio_in_chunks", None)):
        if way in seconds:
            value = share * seconds[way] / mine
            found[name] = Metric(
                value=value, direction="higher", tolerance=0.3, bar=promised, unit="x"
            )
    return found
