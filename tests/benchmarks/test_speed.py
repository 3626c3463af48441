"""`python -m benchmarks speed`: it runs, and its gate closes."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from benchmarks.__main__ import BASELINE, gate, main
from benchmarks.drag_workload import measure_drag
from benchmarks.papr_workloads import measure_render, measure_step
from benchmarks.plan import Plan

from benchmarks import dense, metrics, papr_workloads, scenes
from pcore.geometry.point_cloud import PointCloud
from pcore.kernels.reference import nearest_to_rays
from pcore.model.papr import Papr
from pcore.training.presets import preset


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


def test_the_baseline_holds_the_bars() -> None:
    baseline = metrics.read(BASELINE)
    bars = {name: m.bar for name, m in baseline.items() if m.bar is not None}
    assert bars["search/patch/30000/ratio"] == 400
    assert bars["search/patch/30000/memory"] == 64
    assert bars["search/patch/growth"] == 4
    assert bars["search/near_surface/30000/ratio"] == 50
    assert bars["step/64x64/30000/ratio"] == 4
    assert bars["step/160x160/30000/memory"] == 5
    assert bars["render/200x200/30000/exact/ratio"] == 6
    assert bars["render/200x200/30000/fast/ratio"] == 12
    assert bars["drag/cage/30000/seconds"] == bars["drag/anchor/30000/seconds"] == 0.03
    assert bars["drag/cage/30000/bind"] == bars["drag/anchor/30000/bind"] == 10
    assert metrics.regressions(baseline, baseline) == []


def test_the_dense_formula_is_the_specification() -> None:
    rays, points = scenes.patch(8, 40).flat(), scenes.cloud(500)
    found = dense.nearest_to_rays(rays.origins, rays.directions, points, 5, pairs=1200)
    expected = nearest_to_rays(rays.origins, rays.directions, points, 5)
    assert torch.equal(found, expected)


@pytest.fixture
def untrained() -> tuple[Papr, PointCloud]:
    return scenes.papr(preset("paper").model, scenes.cloud(150), torch.device("cpu"))


def test_the_dense_picture_is_that_of_the_specification(
    untrained: tuple[Papr, PointCloud], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Written anew from the paper, in any chunks: the reference kernels give the same."""
    monkeypatch.setenv("PCORE_KERNELS", "reference")
    (papr, cloud), rays = untrained, scenes.patch(8, 40)
    with torch.no_grad():
        expected = papr(cloud, rays).rgb
        for most in (17, 4096):
            found = dense.papr_picture(papr, cloud, rays, pairs=1000, most=most)
            torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)


def test_scores_of_untrained_models_are_cut_about_as_in_trained_ones(
    untrained: tuple[Papr, PointCloud],
) -> None:
    """Where all or none were cut, the backward pass would have less or more to do."""
    papr, cloud = untrained
    with torch.no_grad():
        weights = papr.attend(cloud, scenes.patch(8, 40).flat())[0].weights
    cut = weights == weights.amin(dim=1, keepdim=True)
    assert 0.3 < float(cut.double().mean()) < 0.8


def test_a_step_and_a_picture_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(papr_workloads, "_REPEATS", 1)
    plan = Plan(device=torch.device("cpu"), quick=True, repeats=1)
    found = dict(measure_step(plan)) | dict(measure_render(plan))
    error = {kind: found[f"step/8x8/200/gradient_error/{kind}"].value for kind in ("ours", "dense")}
    assert error["ours"] < 5 * error["dense"] < 0.05
    assert found["render/16x16/200/exact/error"].value < 1e-5
    assert 0 < found["render/16x16/200/fast/kept"].value <= 0.5
    assert all(metric.value > 0 for metric in found.values())


def test_drags_are_measured() -> None:
    plan = Plan(device=torch.device("cpu"), quick=True, repeats=1)
    found = dict(measure_drag(plan))
    assert set(found) == {
        f"drag/{kind}/300/{what}" for kind in ("cage", "anchor") for what in ("bind", "seconds")
    }
    for kind in ("cage", "anchor"):
        assert found[f"drag/{kind}/300/seconds"].value < found[f"drag/{kind}/300/bind"].value


def test_rays_near_the_surface_have_origins_of_their_own_and_hit_it() -> None:
    rays, points = scenes.near_surface(12, 60, scenes.cloud(2000))
    assert len(rays.origins.unique(dim=0)) == 144
    nearest = nearest_to_rays(rays.origins, rays.directions, points, 1)[:, 0]
    to_nearest = points[nearest] - rays.origins
    assert float(to_nearest.norm(dim=-1).median()) < 1.0
    assert float(torch.linalg.cross(to_nearest, rays.directions).norm(dim=-1).median()) < 0.05
