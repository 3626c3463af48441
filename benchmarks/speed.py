"""`python -m benchmarks speed`: ours against the dense formulas, in one run and taking turns."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch

from benchmarks import metrics
from benchmarks.measure import machine
from benchmarks.plan import Plan
from benchmarks.workloads import WORKLOADS

BASELINE = Path(__file__).with_name("baseline.json")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument("--out", type=Path, help="write the result here (JSON), also as a baseline")
    parser.add_argument("--gate", action="store_true", help="compare with the baseline and fail")
    parser.add_argument("--baseline", type=Path, default=BASELINE, help="what --gate compares with")
    parser.add_argument(
        "--only", nargs="+", choices=list(WORKLOADS), default=(), help="workloads to measure"
    )
    parser.add_argument(
        "--all", action="store_true", help="the whole matrix of points, image sizes and k: an hour"
    )
    parser.add_argument("--quick", action="store_true", help="tiny sizes: only that it runs")
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    parser.add_argument("--threads", type=int, default=1, help="of torch and of the kernels")


def run(wanted: argparse.Namespace) -> int:
    """Measure, print, write and compare; return the exit status."""
    torch.set_num_threads(wanted.threads)
    plan = Plan(
        device=torch.device(wanted.device),
        quick=wanted.quick,
        whole=wanted.all,
        turns=1 if wanted.quick else 5,
    )
    found: dict[str, metrics.Metric] = {}
    for name in wanted.only or WORKLOADS:
        for key, metric in WORKLOADS[name](plan):
            found[key] = metric
            print(_line(key, metric), flush=True)
    if wanted.out is not None:
        metrics.write(wanted.out, found, machine(plan.device, wanted.threads))
    if wanted.gate:
        return gate(found, wanted.baseline, wanted.only)
    lines = metrics.missed(found)
    for line in lines:
        print(f"missed: {line}", file=sys.stderr)
    return 1 if lines else 0


def _line(name: str, metric: metrics.Metric) -> str:
    """A measured number, with what was promised beside it."""
    measured = f"{name:50} {metric.value:12.4g}{metric.unit}"
    if metric.bar is None:
        return measured
    verdict = "missed" if metrics.missed({name: metric}) else "kept"
    return f"{measured:70} bar {metric.bar:.4g}{metric.unit}, {verdict}"


def gate(found: Mapping[str, metrics.Metric], baseline: Path, only: Sequence[str]) -> int:
    """Print what is worse than the baseline and what it does not hold; return the exit status."""
    expected = metrics.read(baseline)
    if only:
        expected = {name: m for name, m in expected.items() if name.split("/")[0] in only}
    for name in metrics.unknown(found, expected):
        print(f"not in the baseline, so nothing guards it: {name}", file=sys.stderr)
    lines = metrics.regressions(found, expected)
    for line in lines:
        print(f"worse: {line}", file=sys.stderr)
    # A bar counts, whether the baseline knows of it or not.
    new = {name: m for name, m in found.items() if name not in expected}
    missed = metrics.missed(new)
    for line in missed:
        print(f"worse: {line}", file=sys.stderr)
    return 1 if lines or missed else 0
