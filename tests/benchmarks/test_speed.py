"""`python -m benchmarks speed`: it runs, and its gate closes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from benchmarks.__main__ import main
from benchmarks.attention_workload import measure_attention
from benchmarks.drag_workload import measure_drag
from benchmarks.gaussian_workload import measure_gaussians
from benchmarks.measure import in_turns
from benchmarks.papr_workloads import measure_render, measure_step
from benchmarks.plan import Plan
from benchmarks.speed import BASELINE, gate
from benchmarks.studio_server import megabytes
from benchmarks.studio_workload import measure_studio

from benchmarks import dense, metrics, scenes
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.kernels.reference import nearest_to_rays
from pcore.model.papr import Papr
from pcore.render.trace import trace
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
    assert bars["render/200x200/30000/fast/psnr"] == 50
    assert bars["gaussians/100x100/10000/both/seconds"] == 0.025
    assert bars["gaussians/200x200/10000/edited/seconds"] == 0.025
    assert bars["gaussians/400x400/100000/at_rest/seconds"] == 0.3
    assert bars["step/64x64/30000/gradient_error/ours"] == 1e-3
    assert metrics.regressions(baseline, baseline) == []


def test_what_the_baseline_does_not_hold_is_said_and_its_bar_counts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = metrics.Metric(value=2.0, direction="higher", tolerance=0.1, bar=1.0)
    metrics.write(tmp_path / "x.json", {}, {})
    assert gate({"step/new": one}, tmp_path / "x.json", ()) == 0
    assert "not in the baseline, so nothing guards it: step/new" in capsys.readouterr().err
    assert gate({"step/new": replace(one, value=0.5)}, tmp_path / "x.json", ()) == 1


def test_unknown_workloads_are_refused_by_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["benchmarks", "speed", "--only", "atention"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    shown = capsys.readouterr().err
    assert "invalid choice: 'atention'" in shown
    assert "attention" in shown.replace("atention", "")


def test_calls_take_turns_and_the_middle_one_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    times = iter([9.0, 9.0, 1.0, 10.0, 5.0, 30.0, 3.0, 20.0])

    def seconds(call: Callable[[], object]) -> float:
        call()
        return next(times)

    monkeypatch.setattr("benchmarks.measure.seconds", seconds)
    found = in_turns({name: lambda name=name: order.append(name) for name in "ab"}, 3)
    assert order == list("abababab")
    assert found == {"a": 3.0, "b": 20.0}
    assert Plan(device=torch.device("cpu"), turns=5).long_turns == 3


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
        expected = scenes.training_colours(papr, cloud, rays)
        for most in (17, 4096):
            found = dense.papr_picture(papr, cloud, rays, pairs=1000, most=most)
            torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)


def test_scores_of_untrained_models_are_cut_about_as_in_trained_ones(
    untrained: tuple[Papr, PointCloud],
) -> None:
    """Where all or none were cut, the backward pass would have less or more to do."""
    papr, cloud = untrained
    with torch.no_grad():
        weights = trace(papr, PosedCloud.at_rest(cloud), scenes.patch(8, 40)).weights
    cut = weights == weights.amin(dim=1, keepdim=True)
    assert 0.3 < float(cut.double().mean()) < 0.8


def test_attention_a_step_and_a_picture_are_measured() -> None:
    plan = Plan(device=torch.device("cpu"), quick=True, turns=1)
    workloads = (measure_attention, measure_step, measure_render)
    found = {name: metric for measure in workloads for name, metric in measure(plan)}
    error = {kind: found[f"step/8x8/200/gradient_error/{kind}"].value for kind in ("ours", "dense")}
    assert error["ours"] < 5 * error["dense"] < 0.05
    assert metrics.missed(found) == []
    assert found["render/16x16/200/exact/error"].value < 1e-5
    assert 0 < found["render/16x16/200/fast/kept"].value <= 0.5
    assert 20 < found["render/16x16/200/fast/psnr"].value < 100
    for kind in ("forward", "both"):
        assert found[f"attention/8x8/200/{kind}/ratio"].value > 0
    for kind in ("exact", "fast"):
        assert found[f"render/16x16/200/{kind}/ratio"].value > 0
    assert all(metric.value > 0 for metric in found.values())


def test_drags_are_measured() -> None:
    plan = Plan(device=torch.device("cpu"), quick=True, turns=1)
    found = dict(measure_drag(plan))
    assert set(found) == {
        f"drag/{kind}/300/{what}" for kind in ("cage", "anchor") for what in ("bind", "seconds")
    }
    for kind in ("cage", "anchor"):
        assert found[f"drag/{kind}/300/seconds"].value < found[f"drag/{kind}/300/bind"].value


def test_pictures_of_gaussians_are_measured() -> None:
    found = dict(measure_gaussians(Plan(device=torch.device("cpu"), quick=True, turns=1)))
    names = ["10x10/200/both", "20x20/200/edited", "40x40/600/at_rest"]
    assert [*found] == [f"gaussians/{name}/seconds" for name in names]
    assert all(metric.value > 0 for metric in found.values())


def test_the_budgets_of_the_page_are_measured() -> None:
    found = dict(measure_studio(Plan(device=torch.device("cpu"), quick=True, turns=1)))
    names = {name.removesuffix("/seconds") for name in found}
    kinds = ("twist", "anchors", "part", "cage", "mesh", "displacement")
    assert {f"studio/{what}/{kind}/300" for what in ("drag", "commit") for kind in kinds} <= names
    assert found["studio/stack/300/differing"].value == 0
    assert 0 < found["studio/frames/300/quick_error"].value < 0.1
    assert 0 < found["studio/start/seconds"].value < 60
    # Five hundred commands of a person; twenty thousand are asked for without --quick.
    assert found["studio/server/growth"].value < 0.05
    assert 100 < found["studio/server/memory"].value < 2000
    assert not metrics.missed(found)


def test_memory_that_is_kept_is_seen() -> None:
    before = megabytes()
    kept = torch.ones(25 * 2**20 // 4)
    assert megabytes() - before > 15
    del kept


def test_a_missed_bar_is_named_and_is_the_exit_status(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    slow = metrics.Metric(value=2.0, direction="lower", tolerance=0.1, bar=1.0, unit=" s")
    workloads = {
        "studio": lambda plan: iter(
            [
                ("studio/x", slow),
                ("studio/y", slow.__class__(value=0.5, direction="lower", tolerance=0.1, bar=1.0)),
            ]
        )
    }
    monkeypatch.setattr("benchmarks.speed.WORKLOADS", workloads)
    monkeypatch.setattr(sys, "argv", ["benchmarks", "speed", "--only", "studio"])
    monkeypatch.setattr(torch, "set_num_threads", lambda count: None)
    assert main() == 1
    said = capsys.readouterr()
    assert "missed: studio/x: 2 s misses the bar of 1" in said.err
    assert "studio/y" not in said.err
    assert "kept" in said.out


def test_rays_near_the_surface_have_origins_of_their_own_and_hit_it() -> None:
    rays, points = scenes.near_surface(12, 60, scenes.cloud(2000))
    assert len(rays.origins.unique(dim=0)) == 144
    nearest = nearest_to_rays(rays.origins, rays.directions, points, 1)[:, 0]
    to_nearest = points[nearest] - rays.origins
    assert float(to_nearest.norm(dim=-1).median()) < 1.0
    assert float(torch.linalg.cross(to_nearest, rays.directions).norm(dim=-1).median()) < 0.05
