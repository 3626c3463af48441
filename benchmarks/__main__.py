"""`python -m benchmarks speed [--out FILE] [--gate]` and `python -m benchmarks gpu DATA`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro

from benchmarks import metrics
from benchmarks.gpu import Gpu
from benchmarks.measure import machine
from benchmarks.plan import Plan
from benchmarks.workloads import WORKLOADS

BASELINE = Path(__file__).with_name("baseline.json")


@dataclass(frozen=True, kw_only=True)
class Speed:
    """Measure ours against the dense formulas, in one run and taking turns."""

    out: Path | None = None
    """Write the result here (JSON); it can become the new baseline."""
    gate: bool = False
    """Compare with the baseline and fail on regressions."""
    baseline: Path = BASELINE
    """What --gate compares with."""
    only: tuple[str, ...] = ()
    """Workloads to measure; all by default."""
    quick: bool = False
    """Tiny sizes that only show that everything runs."""
    device: str = "cpu"
    """cpu or cuda."""
    threads: int = 1
    """Of torch and of the kernels."""

    def run(self) -> int:
        """Measure, print, write and compare; return the exit status."""
        torch.set_num_threads(self.threads)
        plan = Plan(
            device=torch.device(self.device), quick=self.quick, repeats=1 if self.quick else 5
        )
        found: dict[str, metrics.Metric] = {}
        for name in self.only or WORKLOADS:
            for key, metric in WORKLOADS[name](plan):
                found[key] = metric
                print(f"{key:50} {metric.value:12.4g}{metric.unit}", flush=True)
        if self.out is not None:
            metrics.write(self.out, found, machine(plan.device, self.threads))
        return gate(found, self.baseline, self.only) if self.gate else 0


def gate(found: dict[str, metrics.Metric], baseline: Path, only: tuple[str, ...]) -> int:
    """Print what is worse than the baseline; return the exit status."""
    expected = metrics.read(baseline)
    if only:
        expected = {name: m for name, m in expected.items() if name.split("/")[0] in only}
    lines = metrics.regressions(found, expected)
    for line in lines:
        print(f"worse: {line}", file=sys.stderr)
    return 1 if lines else 0


def main() -> int:
    """Run the command line."""
    command = tyro.extras.subcommand_cli_from_dict(
        {"speed": Speed, "gpu": Gpu}, prog="python -m benchmarks"
    )
    return command.run()


if __name__ == "__main__":
    sys.exit(main())
