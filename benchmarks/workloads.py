"""What is measured. A workload is a function that yields named metrics; add yours to WORKLOADS."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from benchmarks.attention_workload import measure_attention
from benchmarks.drag_workload import measure_drag
from benchmarks.gaussian_workload import measure_gaussians
from benchmarks.metrics import Metric
from benchmarks.papr_workloads import measure_render, measure_step
from benchmarks.plan import Plan
from benchmarks.search_workload import measure_search
from benchmarks.studio_workload import measure_studio

WORKLOADS: dict[str, Callable[[Plan], Iterator[tuple[str, Metric]]]] = {
    "search": measure_search,
    "attention": measure_attention,
    "step": measure_step,
    "render": measure_render,
    "drag": measure_drag,
    "studio": measure_studio,
    "gaussians": measure_gaussians,
}
