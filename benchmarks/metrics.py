"""Numbers with a meaning: which way is better, how much they may scatter, what was promised."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

Direction = Literal["higher", "lower"]


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One measured number."""

    value: float
    direction: Direction
    """Which way is better."""
    tolerance: float
    """Part of the baseline's value by which a new one may be worse."""
    bar: float | None = None
    """What was promised; worse than that is a failure whatever the baseline says."""
    unit: str = ""

    def worse_than(self, other: float) -> bool:
        """Whether another value would be better."""
        return self.value < other if self.direction == "higher" else self.value > other


def regressions(found: Mapping[str, Metric], baseline: Mapping[str, Metric]) -> list[str]:
    """Say what is worse than the baseline by more than its tolerance, below its bar, or missing.

    The baseline's direction, tolerance and bar count, so that a change of them is a change of that
    file. Metrics that only the new result has are no regressions.
    """
    lines: list[str] = []
    for name, old in baseline.items():
        new = found.get(name)
        if new is None:
            lines.append(f"{name}: in the baseline, but not measured")
            continue
        sign = -1 if old.direction == "higher" else 1
        limit = old.value * (1 + sign * old.tolerance)
        if math.isnan(new.value):
            lines.append(f"{name}: is no number")
            continue
        judged = Metric(value=new.value, direction=old.direction, tolerance=old.tolerance)
        if judged.worse_than(limit):
            lines.append(
                f"{name}: {new.value:.4g}{new.unit}, the baseline is {old.value:.4g}{old.unit} "
                f"({old.direction} is better, limit {limit:.4g})"
            )
        elif old.bar is not None and judged.worse_than(old.bar):
            lines.append(f"{name}: {new.value:.4g}{new.unit} misses the bar of {old.bar:.4g}")
    return lines


def missed(found: Mapping[str, Metric]) -> list[str]:
    """Say what misses its own bar."""
    return [
        f"{name}: {one.value:.4g}{one.unit} misses the bar of {one.bar:.4g}"
        for name, one in found.items()
        # What is no number is no better than any bar.
        if one.bar is not None and (one.worse_than(one.bar) or math.isnan(one.value))
    ]


def unknown(found: Mapping[str, Metric], baseline: Mapping[str, Metric]) -> list[str]:
    """Names of what was measured and is not in the baseline, which therefore guards nothing."""
    return [name for name in found if name not in baseline]


def write(path: Path, metrics: Mapping[str, Metric], machine: Mapping[str, object]) -> None:
    """Write a result; it can serve as a baseline."""
    content = {
        "machine": dict(machine),
        "metrics": {name: asdict(metric) for name, metric in metrics.items()},
    }
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read(path: Path) -> dict[str, Metric]:
    """Read the metrics of a result or a baseline."""
    content = json.loads(path.read_text(encoding="utf-8"))
    return {name: Metric(**fields) for name, fields in content["metrics"].items()}
