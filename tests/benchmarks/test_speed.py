"""`python -m benchmarks speed`: it runs, and its gate closes."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from benchmarks.__main__ import BASELINE, gate, main

from benchmarks import dense, metrics, scenes
from pcore.kernels.reference import nearest_to_rays


@pytest.fixture
def result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "speed.json"
    arguments = ["benchmarks", "speed", "--quick", "--only", "search", "--out", str(path)]
    monkeypatch.setattr(sys, "argv", arguments)
    threads = torch.get_num_threads()
    assert main() == 0
    torch.set_num_threads(threads)
    return path


def test_a_quick_run_and_its_gate(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = metrics.read(result)
    assert {name.split("/")[0] for name in found} == {"search"}
    same = [m.value for name, m in found.items() if name.endswith("same_neighbours")]
    assert len(same) == 6
    assert min(same) > 0.95, "only equal distances may be chosen differently"
    assert gate(found, result, ()) == 0
    # A faked result: the search became ten times slower.
    name = "search/patch/600/ratio"
    slower = found | {name: replace(found[name], value=0.1 * found[name].value)}
    assert gate(slower, result, ("search",)) == 1
    assert f"worse: {name}" in capsys.readouterr().err
    assert gate(slower, result, ("render",)) == 0, "what was not asked for is not missing"


def test_the_baseline_holds_the_bars_of_the_search() -> None:
    baseline = metrics.read(BASELINE)
    bars = {name: m.bar for name, m in baseline.items() if m.bar is not None}
    assert bars["search/patch/30000/ratio"] == 400
    assert bars["search/patch/30000/memory"] == 64
    assert bars["search/patch/growth"] == 4
    assert bars["search/near_surface/30000/ratio"] == 50
    assert metrics.regressions(baseline, baseline) == []


def test_the_dense_formula_is_the_specification() -> None:
    rays, points = scenes.patch(8, 40).flat(), scenes.cloud(500)
    found = dense.nearest_to_rays(rays.origins, rays.directions, points, 5, pairs=1200)
    expected = nearest_to_rays(rays.origins, rays.directions, points, 5)
    assert torch.equal(found, expected)


def test_rays_near_the_surface_have_origins_of_their_own_and_hit_it() -> None:
    rays, points = scenes.near_surface(12, 60, scenes.cloud(2000))
    assert len(rays.origins.unique(dim=0)) == 144
    nearest = nearest_to_rays(rays.origins, rays.directions, points, 1)[:, 0]
    to_nearest = points[nearest] - rays.origins
    assert float(to_nearest.norm(dim=-1).median()) < 1.0
    assert float(torch.linalg.cross(to_nearest, rays.directions).norm(dim=-1).median()) < 0.05
