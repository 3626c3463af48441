"""`python -m benchmarks gpu DATA`: what a machine with a GPU and without network is asked.

Parity with the specification, speed, real trainings, pictures in a loop: in under ten minutes, into
one JSON file. `--quick --device cpu` shows on any machine that it runs.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import torch

from benchmarks import metrics
from benchmarks.attention_workload import measure_attention
from benchmarks.measure import machine
from benchmarks.parity import measure_parity
from benchmarks.plan import Plan
from benchmarks.search_workload import measure_search
from benchmarks.training_workload import load, measure_loop, measure_pictures, measure_training
from pcore.training.trained import Trained

Found = Iterator[tuple[str, metrics.Metric]]
PARTS = ("parity", "loop", "training", "pictures", "search", "attention")
"""In the order of what would be missed most if the machine went away."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument("data", type=Path, help="folder of a scene; at most 60 MB travel well")
    parser.add_argument("--out", type=Path, default=Path("gpu.json"), help="written part by part")
    parser.add_argument("--device", default="cuda", help="cuda, or cpu with --quick")
    parser.add_argument("--factor", type=int, default=1, help="down-scaling to 400 x 400 pixels")
    parser.add_argument(
        "--training-seconds",
        type=float,
        default=240.0,
        help="time that the `fast` preset may train; warm steps say how many fit",
    )
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, help="parts to run")
    parser.add_argument("--quick", action="store_true", help="tiny sizes: only that it runs")


def run(wanted: argparse.Namespace) -> int:
    """Measure part after part; return the exit status, 1 where a bound or a bar is missed."""
    plan = Plan(
        device=torch.device(wanted.device), quick=wanted.quick, turns=1 if wanted.quick else 3
    )
    begin, found = time.perf_counter(), dict[str, metrics.Metric]()
    for name, part in _parts(wanted, plan).items():
        for key, metric in part():
            found[key] = metric
            print(f"{key:50} {metric.value:12.4g}{metric.unit}", flush=True)
        print(f"{name} done after {time.perf_counter() - begin:.0f} s", flush=True)
        # A lease that ends early leaves the parts that were done.
        metrics.write(wanted.out, found, machine(plan.device, torch.get_num_threads()))
    lines = metrics.missed(found)
    for line in lines:
        print(line, file=sys.stderr)
    return 1 if lines else 0


def _parts(wanted: argparse.Namespace, plan: Plan) -> dict[str, Callable[[], Found]]:
    """The wanted parts; what one of them learns the later ones use."""
    trained: list[Trained] = []
    scene = load(wanted.data, wanted.factor)
    steps: dict[str, float] = {}

    def loop() -> Found:
        for name in ("paper", "fast"):
            for key, metric in measure_loop(scene, name, plan):
                steps[key] = metric.value
                yield key, metric

    def training() -> Found:
        if not steps:
            dict(loop())  # Its warm steps say how many fit.
        step = steps["loop/fast/milliseconds"] / 1e3
        return measure_training(scene, wanted.training_seconds, step, plan, trained)

    parts: dict[str, Callable[[], Found]] = {
        "parity": lambda: measure_parity(plan),
        "loop": loop,
        "training": training,
        "pictures": lambda: measure_pictures(trained[-1] if trained else None, plan),
        "search": lambda: measure_search(plan),
        "attention": lambda: measure_attention(plan),
    }
    return {name: part for name, part in parts.items() if name in wanted.only}
