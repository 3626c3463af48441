"""Metrics: what counts as a regression, and files that can serve as baselines."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from benchmarks.metrics import Metric, missed, read, regressions, unknown, write


def ratio(value: float, *, bar: float | None = None) -> Metric:
    return Metric(value=value, direction="higher", tolerance=0.3, bar=bar, unit="x")


def megabytes(value: float) -> Metric:
    return Metric(value=value, direction="lower", tolerance=0.5, unit=" MB")


@pytest.mark.parametrize(
    ("new", "old", "fails"),
    [
        (ratio(70.1), ratio(100), False),
        (ratio(69.9), ratio(100), True),
        (ratio(500), ratio(100), False),
        (megabytes(14.9), megabytes(10), False),
        (megabytes(15.1), megabytes(10), True),
        (megabytes(1), megabytes(10), False),
        (ratio(99), ratio(100, bar=100), True),
        (ratio(100), ratio(100, bar=100), False),
    ],
)
def test_tolerance_direction_and_bar(new: Metric, old: Metric, fails: bool) -> None:
    assert bool(regressions({"a": new}, {"a": old})) == fails


def test_the_baseline_decides_what_is_tolerated() -> None:
    lax = Metric(value=1.0, direction="higher", tolerance=1.0)
    assert regressions({"a": lax}, {"a": ratio(100)})


def test_what_is_not_measured_any_more_is_a_regression_and_what_is_new_is_none() -> None:
    assert regressions({}, {"a": ratio(1)}) == ["a: in the baseline, but not measured"]
    assert regressions({"b": ratio(1)}, {}) == []


def test_what_misses_its_own_bar_and_what_is_no_number() -> None:
    found = {"a": ratio(3, bar=2), "b": ratio(1, bar=2), "c": ratio(math.nan, bar=2), "d": ratio(0)}
    assert [line.split(":")[0] for line in missed(found)] == ["b", "c"]
    assert regressions({"a": ratio(math.nan)}, {"a": ratio(1)}) == ["a: is no number"]
    assert unknown(found, {"a": ratio(1), "d": ratio(1)}) == ["b", "c"]


def test_a_result_can_be_read_as_a_baseline(tmp_path: Path) -> None:
    found = {"a": ratio(3, bar=2), "b": megabytes(4)}
    write(tmp_path / "x.json", found, {"device": "a machine"})
    assert read(tmp_path / "x.json") == found
