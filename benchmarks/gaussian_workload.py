"""Pictures of Gaussians: a step of the rasteriser, an edited object, a large one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import torch
from torch.nn.functional import normalize

from benchmarks import scenes
from benchmarks.measure import in_turns
from benchmarks.metrics import Metric
from benchmarks.plan import Plan
from pcore.deform.frame import axis_frame
from pcore.deform.simple import Twist
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint, PosedGaussians, pose, render

_STEP, _EDITED, _LARGE = 0.025, 0.025, 0.3
"""Seconds that were promised: forward and backward at 100 x 100, a frame of an edited object at
200 x 200, both of 10,000; a frame of 100,000 at 400 x 400 (on two cores)."""
_AREA = 3.6
"""Of the surface of `scenes.cloud`, square world units, about."""


def measure_gaussians(plan: Plan) -> Iterator[tuple[str, Metric]]:
    """Frames of Gaussians that are pieces of a surface, with and without gradients."""
    few, many = (200, 600) if plan.quick else (10_000, 100_000)
    sides = (10, 20, 40) if plan.quick else (100, 200, 400)
    calls = {
        f"gaussians/{sides[0]}x{sides[0]}/{few}/both": (_step(plan, few, sides[0]), _STEP),
        f"gaussians/{sides[1]}x{sides[1]}/{few}/edited": (_edited(plan, few, sides[1]), _EDITED),
        f"gaussians/{sides[2]}x{sides[2]}/{many}/at_rest": (_large(plan, many, sides[2]), _LARGE),
    }
    found = in_turns({name: call for name, (call, _) in calls.items()}, plan.turns)
    for name, (_, bar) in calls.items():
        yield (
            f"{name}/seconds",
            Metric(
                value=found[name],
                direction="lower",
                tolerance=3.0,
                bar=bar if plan.bars else None,
                unit=" s",
            ),
        )


def _step(plan: Plan, count: int, side: int) -> Callable[[], None]:
    """Forward and backward to all that is learned, one colour each: the rasteriser itself."""
    leaves = _pieces(plan, count, degree=0).each(lambda one: one.requires_grad_(True))
    camera = scenes.camera(side)

    def call() -> None:
        leaves.each(_without_gradient)
        seen = render(PosedGaussians(gaussians=leaves), [camera], footprint=Footprint())
        (seen.rgb.square().mean() + seen.alpha.mean()).backward()

    return call


def _edited(plan: Plan, count: int, side: int) -> Callable[[], None]:
    """A frame of an object that was twisted and lit before."""
    rest = _pieces(plan, count, degree=3)
    twist = Twist(rotation=axis_frame("z"), origin=torch.zeros(3), extent=(-1.0, 1.0), value=1.0)
    places = rest.means.cpu()
    maps = twist.jacobian(places).to(rest.means)
    posed = pose(rest, twist(places).to(rest.means), maps, torch.full_like(rest.means[:, :1], 0.8))
    return lambda: _frame(posed, side)


def _large(plan: Plan, count: int, side: int) -> Callable[[], None]:
    posed = PosedGaussians(gaussians=_pieces(plan, count, degree=3))
    return lambda: _frame(posed, side)


@torch.no_grad()
def _frame(posed: PosedGaussians, side: int) -> None:
    render(posed, [scenes.camera(side)], footprint=Footprint())


def _without_gradient(tensor: torch.Tensor) -> torch.Tensor:
    tensor.grad = None
    return tensor


def _pieces(plan: Plan, count: int, *, degree: int) -> Gaussians:
    """Flat Gaussians that cover a surface, as wide as they are apart, turned anyhow."""
    source = torch.Generator().manual_seed(1)
    sides = torch.tensor([0.6, 0.6, 0.1]) * math.sqrt(_AREA / count)
    gaussians = Gaussians(
        means=scenes.cloud(count),
        quats=normalize(torch.randn(count, 4, generator=source), dim=1),
        scales=sides.expand(count, 3).contiguous(),
        opacities=torch.full((count,), 0.7),
        sh=0.3 * torch.randn(count, (degree + 1) ** 2, 3, generator=source),
    )
    return gaussians.to(plan.device)
