"""Two processes that train one object: the same run as one process, and the same bits in both."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tests.small_training import pretrain_config
from tests.tiny_scene import write_scene

from pcore.capture.load import load_scene
from pcore.cli.main import main
from pcore.errors import InputError
from pcore.training.config import GrowConfig, PatchConfig, PretrainConfig, PruneConfig
from pcore.training.events import Event, PopulationReport, StepReport
from pcore.training.pretrain import pretrain
from pcore.training.ranks import Ranks

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


def told(scene: Path) -> dict[str, Any]:
    """Train here; what was reported, and the result."""
    events: list[Event] = []
    found = pretrain(load_scene(scene), settings(), listener=events.append)
    weights = [*found.papr.state_dict().values(), found.cloud.positions, found.cloud.features]
    return {
        "losses": [one.loss for one in events if isinstance(one, StepReport)],
        "population": [
            (one.step, one.pruned, one.grown) for one in events if isinstance(one, PopulationReport)
        ],
        "bits": [np.asarray(one).tobytes().hex() for one in weights],
    }


def work(rank: int, folder: Path) -> None:
    """What one of the processes does."""
    torch.set_num_threads(1)
    torch.distributed.init_process_group(
        "gloo", init_method=f"file://{folder / 'meeting'}", rank=rank, world_size=2
    )
    (folder / f"{rank}.json").write_text(json.dumps(told(folder / "box")))
    torch.distributed.destroy_process_group()


def started(folder: Path) -> list[subprocess.Popen[bytes]]:
    code = "import sys, pathlib; from tests.training.test_ranks import work\n"
    code += "work(int(sys.argv[1]), pathlib.Path(sys.argv[2]))"
    paths = [str(ROOT), str(ROOT / "tests"), *sys.path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    return [
        subprocess.Popen([sys.executable, "-c", code, str(rank), str(folder)], env=environment)
        for rank in range(2)
    ]


@pytest.mark.slow
@pytest.mark.skipif(not torch.distributed.is_available(), reason="this torch has no distributed")
def test_two_processes_are_one_with_the_whole_batch(tmp_path: Path) -> None:
    write_scene(tmp_path / "box")
    processes = started(tmp_path)
    alone = told(tmp_path / "box")
    assert [process.wait(timeout=200) for process in processes] == [0, 0]
    first, second = (json.loads((tmp_path / f"{rank}.json").read_text()) for rank in range(2))
    assert first == second
    # Sums of two halves round in another way than the sum of all, and small differences grow.
    early = np.array(alone["losses"][:5])
    assert np.abs(np.array(first["losses"][:5]) / early - 1).max() < 1e-3
    late = np.mean(alone["losses"][-8:])
    assert np.mean(first["losses"][-8:]) == pytest.approx(late, rel=0.2)
    assert alone["losses"][-1] < 0.5 * alone["losses"][0]
    assert any(grown for _, _, grown in first["population"])
    assert any(pruned for _, pruned, _ in first["population"])
    assert first["population"][0] == [*alone["population"][0]]


def test_a_batch_is_shared_without_rest() -> None:
    shares: list[Sequence[int]] = [Ranks(rank=k, count=3).share(range(7)) for k in range(3)]
    assert sorted(item for share in shares for item in share) == [*range(7)]
    with pytest.raises(InputError, match="--patches 3"):
        Ranks(rank=0, count=3).share(range(2))


def test_alone_nothing_is_exchanged() -> None:
    ranks, tensor = Ranks(), torch.ones(3)
    ranks.add([tensor])
    ranks.check_same({"a": tensor}, 1)
    assert torch.equal(tensor, torch.ones(3))
    assert (ranks.any(True), ranks.any(False), ranks.from_first("x")) == (True, False, "x")


@pytest.mark.parametrize("verb", ["train", "finetune"])
def test_what_does_not_share_its_work_says_so(
    verb: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("WORLD_SIZE", "2")
    assert main([verb, "nowhere", "-o", "run"]) == 2
    assert "expected one process, got 2 by torchrun" in capsys.readouterr().err
