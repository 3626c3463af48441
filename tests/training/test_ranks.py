"""Two processes that train one object: the same run as one process, and the same bits in both."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tests.small_training import finetune_config, pretrain_config
from tests.tiny_scene import write_scene

from pcore.capture.load import load_scene
from pcore.cli.main import main
from pcore.errors import InputError
from pcore.files.run_folder import RunFolder
from pcore.training.config import GrowConfig, PatchConfig, PretrainConfig, PruneConfig
from pcore.training.events import Event, PopulationReport, Saved, StepReport
from pcore.training.finetune import finetune
from pcore.training.gaussian_config import (
    DensityConfig,
    GaussianConfig,
    GaussianFinetuneConfig,
)
from pcore.training.gaussian_finetune import finetune_gaussians
from pcore.training.gaussian_fit import fit_gaussians
from pcore.training.pretrain import pretrain
from pcore.training.ranks import Ranks, by_itself, current_ranks
from pcore.training.schedule import Level

ROOT = Path(__file__).resolve().parent.parent.parent


def settings() -> PretrainConfig:
    """200 steps of two patches; points go and come in between."""
    return pretrain_config(
        steps=200,
        patch=PatchConfig(side=16, views=2),
        prune=PruneConfig(every=60, first=60, last=200, threshold=0.95),
        grow=GrowConfig(every=50, first=50, last=200, count=10, limit=120),
        validate_every=100,
        save_every=100,
    )


def gaussian_settings() -> GaussianConfig:
    """200 steps of two photos; Gaussians come and go, photos become finer in between."""
    return GaussianConfig(
        steps=200,
        views=2,
        points=100,
        density=DensityConfig(every=20, first=20, last=0.5, gradient=3e-4, faint=0.05, limit=250),
        levels=(Level(until=0.3, reduction=2),),
        exposure="per-view",
        validate_every=100,
        save_every=50,
        hold_out=3,
        seed=3,
    )


def tuned(scene: Path, kind: str) -> dict[str, Any]:
    """Fine-tune what this process has trained by itself; what was reported, and the result."""
    events: list[Event] = []
    opened = load_scene(scene)
    if kind == "tuned papr":
        with by_itself():
            base = pretrain(opened, replace(settings(), steps=20, prune=None, grow=None))
        config = finetune_config(steps=60, patch=PatchConfig(side=16, views=2), save_every=30)
        papr = finetune(opened, base, config, listener=events.append)
        weights = [*papr.papr.state_dict().values(), papr.cloud.positions, papr.cloud.features]
    else:
        with by_itself():
            start = fit_gaussians(opened, replace(gaussian_settings(), steps=40, exposure=None))
        config = GaussianFinetuneConfig(
            steps=60, views=2, rays=40, hold_out=3, validate_every=30, save_every=30, seed=1
        )
        splats = finetune_gaussians(opened, start, config, listener=events.append)
        weights = [splats.gaussians.means, splats.gaussians.scales, splats.gaussians.sh]
    steps = [one for one in events if isinstance(one, StepReport)]
    return {
        "losses": [one.loss for one in steps],
        "terms": sorted({name for one in steps for name in one.losses}),
        "bits": [np.asarray(one).tobytes().hex() for one in weights],
    }


def told(scene: Path, kind: str, run: Path | None = None) -> dict[str, Any]:
    """Train here, going on from what lies in the folder; what was reported, and the result."""
    events: list[Event] = []
    opened = load_scene(scene)
    if kind == "papr":
        papr = pretrain(opened, settings(), listener=events.append)
        weights = [*papr.papr.state_dict().values(), papr.cloud.positions, papr.cloud.features]
    else:
        with ExitStack() as stack:
            folder = None
            if run is not None:
                folder = RunFolder.create(
                    run, stage="pretrain", scene="box", config={}, resume=run.exists()
                )
                stack.enter_context(folder)

            def hear(event: Event) -> None:
                events.append(event)
                if run is not None and isinstance(event, Saved) and event.step == 100:
                    shutil.copytree(run, scene.parent / "half", dirs_exist_ok=True)

            splats = fit_gaussians(opened, gaussian_settings(), folder=folder, listener=hear)
        weights = [splats.gaussians.means, splats.gaussians.scales, splats.gaussians.sh]
    return {
        "losses": [one.loss for one in events if isinstance(one, StepReport)],
        "population": [
            (one.step, one.pruned, one.grown) for one in events if isinstance(one, PopulationReport)
        ],
        "bits": [np.asarray(one).tobytes().hex() for one in weights],
    }


def work(rank: int, folder: Path, kind: str) -> None:
    """What one of the processes does."""
    torch.set_num_threads(1)
    torch.distributed.init_process_group(
        "gloo", init_method=f"file://{folder / 'meeting'}", rank=rank, world_size=2
    )
    run = folder / "run" if kind == "gaussians" and rank == 0 else None
    found = (
        tuned(folder / "box", kind) if kind.startswith("tuned") else told(folder / "box", kind, run)
    )
    (folder / f"{rank}.json").write_text(json.dumps(found))
    torch.distributed.destroy_process_group()


def started(folder: Path, kind: str) -> list[subprocess.Popen[bytes]]:
    code = "import sys, pathlib; from tests.training.test_ranks import work\n"
    code += "work(int(sys.argv[1]), pathlib.Path(sys.argv[2]), sys.argv[3])"
    paths = [str(ROOT), str(ROOT / "tests"), *sys.path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    return [
        subprocess.Popen(
            [sys.executable, "-c", code, str(rank), str(folder), kind], env=environment
        )
        for rank in range(2)
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "reports", "early", "late"), [("papr", 5, 1e-3, 0.2), ("gaussians", 3, 1e-5, 0.1)]
)
@pytest.mark.skipif(not torch.distributed.is_available(), reason="this torch has no distributed")
def test_two_processes_are_one_with_the_whole_batch(
    kind: str, reports: int, early: float, late: float, tmp_path: Path
) -> None:
    write_scene(tmp_path / "box")
    processes = started(tmp_path, kind)
    alone = told(tmp_path / "box", kind)
    assert [process.wait(timeout=280) for process in processes] == [0, 0]
    first, second = (json.loads((tmp_path / f"{rank}.json").read_text()) for rank in range(2))
    assert first == second
    # Sums of two halves round in another way than the sum of all, and small differences grow.
    expected = np.array(alone["losses"])
    assert np.abs(np.array(first["losses"]) / expected - 1)[:reports].max() < early
    end = np.mean(expected[-8:])
    assert np.mean(first["losses"][-8:]) == pytest.approx(end, rel=late)
    assert expected[-1] < 0.5 * expected[0]
    assert any(grown for _, _, grown in first["population"])
    assert any(pruned for _, pruned, _ in first["population"])
    assert first["population"][0] == [*alone["population"][0]]
    if kind == "gaussians":
        resumed = told(tmp_path / "box", kind, tmp_path / "half")
        assert len(resumed["losses"]) == 10
        assert np.mean(resumed["losses"][-8:]) == pytest.approx(end, rel=late)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tuned papr", "tuned gaussians"])
@pytest.mark.skipif(not torch.distributed.is_available(), reason="this torch has no distributed")
def test_two_processes_tune_as_one_with_the_whole_batch(kind: str, tmp_path: Path) -> None:
    write_scene(tmp_path / "box")
    processes = started(tmp_path, kind)
    alone = tuned(tmp_path / "box", kind)
    assert [process.wait(timeout=280) for process in processes] == [0, 0]
    first, second = (json.loads((tmp_path / f"{rank}.json").read_text()) for rank in range(2))
    assert first == second
    assert first["terms"] == alone["terms"]
    assert any(name.startswith("geo_") for name in first["terms"])
    # As above: equal but for rounding at first, and near in the end.
    expected, found = np.array(alone["losses"]), np.array(first["losses"])
    assert np.abs(found / expected - 1)[:2].max() < 1e-3
    assert np.mean(found) == pytest.approx(np.mean(expected), rel=0.02)


def test_what_a_process_does_by_itself_is_not_shared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.distributed, "get_rank", lambda: 1)
    monkeypatch.setattr(torch.distributed, "get_world_size", lambda: 2)
    assert current_ranks() == Ranks(rank=1, count=2)
    with by_itself():
        assert current_ranks() == Ranks()
    assert current_ranks() == Ranks(rank=1, count=2)


def test_a_batch_is_shared_without_rest() -> None:
    shares: list[Sequence[int]] = [Ranks(rank=k, count=3).share(range(7)) for k in range(3)]
    assert sorted(item for share in shares for item in share) == [*range(7)]
    with pytest.raises(InputError, match="--patches 3"):
        Ranks(rank=0, count=3).share(range(2))


def test_ranks_that_disagree_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def told(box: list[Any], own: dict[str, str]) -> None:
        box[:] = [own, own, {**own, "photos": "[]"}]

    monkeypatch.setattr(torch.distributed, "all_gather_object", told)
    ranks = Ranks(rank=0, count=3)
    with pytest.raises(InputError, match="the same photos in all of them, got others in process 2"):
        ranks.agree({"photos": ["a"], "points": torch.ones(2)})
    monkeypatch.setattr(
        torch.distributed,
        "all_gather_object",
        lambda box, own: box.__setitem__(slice(None), [own] * 3),
    )
    ranks.agree({"photos": ["a"], "points": torch.ones(2)})


def test_alone_nothing_is_exchanged() -> None:
    ranks, tensor = Ranks(), torch.ones(3)
    ranks.add([tensor])
    ranks.check_same({"a": tensor}, 1)
    assert torch.equal(tensor, torch.ones(3))
    assert (ranks.any(True), ranks.any(False), ranks.from_first("x")) == (True, False, "x")


def test_what_does_not_share_its_work_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("WORLD_SIZE", "2")
    assert main(["light", "nowhere"]) == 2
    assert "expected one process, got 2 by torchrun" in capsys.readouterr().err
