"""Whether the backends of a device give what the specification gives: values, gradients, errors.

Every figure has a bound. The specification is computed in float64 for the same neighbours.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from unittest import mock

import torch
from torch import Tensor

from benchmarks import scenes
from benchmarks.metrics import Metric
from benchmarks.plan import Plan
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.kernels import cpu_search, functional, reference
from pcore.kernels.backends import usable
from pcore.model.papr import Papr
from pcore.render.picture import FAST_THRESHOLD
from pcore.training.loop import autocast
from pcore.training.presets import preset

_MODELS = ("paper", "paper-lego", "fast", "tiny")
_BOUNDS = {"single": (1e-5, 2e-2), "half": (5e-2, 0.2)}
"""Largest errors of values and of gradients, the norm of the error over that of the truth. In
float32 single units that lie on the kink of their ReLU change a gradient of the `paper` sizes by up
to 0.7 percent on a CPU, where values are off by 3e-6 at most."""
_ONE_RAY = 1e-3
"""What a weight that rounding moves across the threshold changes, of 256 rays."""


def measure_parity(plan: Plan) -> Iterator[tuple[str, Metric]]:
    """The search against the CPU and the specification, the attention against the latter."""
    side, count = (8, 100) if plan.quick else (64, 30_000)
    points = scenes.cloud(count)
    yield from _searches(side, points, plan.device)
    for name in _MODELS[-1:] if plan.quick else _MODELS:
        yield from (
            (f"parity/{name}/{key}", metric)
            for key, metric in _attention(name, points, side // 4, plan)  # 256 rays
        )


def _searches(side: int, points: Tensor, device: torch.device) -> Iterator[tuple[str, Metric]]:
    for name, rays, cloud in (
        ("camera", scenes.patch(side, 5 * side).flat(), points),
        ("near_surface", *scenes.near_surface(side, 5 * side, points)),
    ):
        origins, directions = rays.origins.contiguous(), rays.directions.contiguous()
        moved = (origins.to(device), directions.to(device), cloud.to(device))
        mine = functional.nearest_to_rays(*moved, 20)
        expected = cpu_search.nearest_to_rays(origins, directions, cloud, 20)
        yield f"parity/search/{name}/same_as_cpu", _share(mine.cpu(), expected, 1.0)
        # Sums in another order: points equally far within float32 may change places.
        dense = reference.nearest_to_rays(*moved, 20)
        yield (
            f"parity/search/{name}/as_reference",
            _share(mine.sort(-1).values, dense.sort(-1).values, 0.95),
        )


def _share(found: Tensor, expected: Tensor, bar: float) -> Metric:
    value = float((found == expected).all(dim=-1).double().mean())
    return Metric(value=value, direction="higher", tolerance=0.0, bar=bar)


@dataclass(frozen=True, kw_only=True)
class _Case:
    """A model, its points, and rays with the points nearest to them."""

    papr: Papr
    cloud: PointCloud
    rays: RayBundle
    neighbours: Tensor

    def doubled(self) -> _Case:
        cloud = {
            name: getattr(self.cloud, name).detach().double().requires_grad_()
            for name in ("positions", "features", "influence")
        }
        return _Case(
            papr=deepcopy(self.papr).double(),
            cloud=PointCloud.from_tensors(cloud),
            rays=scenes.doubled(self.rays),
            neighbours=self.neighbours,
        )

    def values_and_gradients(self, threshold: float) -> tuple[list[Tensor], list[Tensor]]:
        """Features and background, and gradients for random cotangents."""
        posed = PosedCloud.at_rest(self.cloud)
        found = self.papr.attention(
            posed, self.rays, self.neighbours, self.rays, threshold, stop_encoding=True
        )
        values = [found.features, found.background]
        generator, loss = torch.Generator().manual_seed(1), torch.zeros(())
        for one in values:
            cotangent = torch.randn(one.shape, generator=generator, dtype=torch.float64)
            loss = loss.to(one) + (one * cotangent.to(one)).sum()
        cloud, attention = self.cloud, self.papr.attention
        leaves = [cloud.positions, cloud.features, cloud.influence, *attention.parameters()]
        gradients = torch.autograd.grad(loss, leaves, allow_unused=True, materialize_grads=True)
        return [one.detach() for one in values], list(gradients)


def _attention(name: str, points: Tensor, side: int, plan: Plan) -> Iterator[tuple[str, Metric]]:
    papr, cloud = scenes.papr(preset(name).model, points, plan.device)  # type: ignore[arg-type]
    rays = scenes.on_device(scenes.patch(side, 5 * side).flat(), plan.device)
    neighbours = functional.nearest_to_rays(
        rays.origins, rays.directions, cloud.positions, papr.config.neighbours
    )
    case = _Case(papr=papr, cloud=cloud, rays=rays, neighbours=neighbours)
    precisions = ("single", "half") if plan.device.type == "cuda" else ("single",)
    for threshold in (0.0, FAST_THRESHOLD):
        with mock.patch.dict(os.environ, PCORE_KERNELS="reference"):
            expected = case.doubled().values_and_gradients(threshold)
        for backend in usable(plan.device):
            for precision in precisions:
                with (
                    mock.patch.dict(os.environ, PCORE_KERNELS=backend),
                    autocast(plan.device, enabled=precision == "half"),
                ):
                    found = case.values_and_gradients(threshold)
                label = f"{backend}/{precision}" + ("/fast" if threshold else "")
                of_values, of_gradients = _BOUNDS[precision]
                of_values = max(of_values, _ONE_RAY if threshold else 0.0)
                yield f"values/{label}", _error(found[0], expected[0], of_values)
                yield f"gradients/{label}", _error(found[1], expected[1], of_gradients)


def _error(found: list[Tensor], expected: list[Tensor], bar: float) -> Metric:
    """Return the largest relative error of any of the tensors."""
    errors = [
        float((one.double() - other.double()).norm() / other.double().norm().clamp_min(1e-9))
        for one, other in zip(found, expected, strict=True)
    ]
    # max would overlook NaN.
    value = float(torch.tensor(errors).max())
    return Metric(value=value, direction="lower", tolerance=9.0, bar=bar)
