"""SIGKILL at random moments: a resumed training ends bitwise where an undisturbed one does."""

from __future__ import annotations

import logging
import random
import signal
import time
from collections.abc import Sequence
from pathlib import Path

import pytest
import small_pcore
import torch
from safetensors.torch import load_file
from small_pcore import small_presets
from tests.forked import Forked

from pcore.cli.main import main
from pcore.files.run_folder import RunFolder
from pcore.training import presets
from tiny_scene import write_scene

STEPS, TUNING_STEPS = 150, 60
ONE_THREAD = ("--device", "cpu", "--threads", "1", "--no-tensorboard")


@pytest.fixture(autouse=True)
def _quick_presets(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, function in small_presets().items():
        monkeypatch.setattr(presets, name, function)


PROGRAM = f"import runpy; runpy.run_path({small_pcore.__file__!r}, run_name='__main__')"


def steps_logged(run: Path) -> int:
    log = run / "log.jsonl"
    return log.read_text().count('"event": "step"') if log.is_file() else 0


def kill_later(forked: Forked, arguments: Sequence[str], run: Path, moment: random.Random) -> None:
    """Start, let it log two or three more reports, then kill at random before the next one."""
    reports, seen = moment.randint(2, 3), list[float]()
    before = steps_logged(run)
    process = forked.start(PROGRAM, *arguments, said=run.parent / "said.txt")
    try:
        end = time.monotonic() + 200
        while process.poll() is None and time.monotonic() < end:
            if steps_logged(run) > before + len(seen):
                seen.append(time.monotonic())
            if len(seen) == reports:
                time.sleep(moment.uniform(0, seen[-1] - seen[-2]))
                break
            time.sleep(0.001)
    finally:
        code = process.end()
    # It must have been working to the last: neither failed nor finished.
    assert code == -signal.SIGKILL, process.said.read_text()


def another_moment() -> random.Random:
    """Another moment in every run of the test; a failure's log holds the seed that repeats it."""
    seed = random.randrange(2**32)
    logging.getLogger(__name__).warning("killed at moments of seed %d", seed)
    return random.Random(seed)


def assert_same_model(first: Path, second: Path) -> None:
    expected, found = (load_file(run / "model.safetensors") for run in (first, second))
    assert expected.keys() == found.keys()
    for name, tensor in expected.items():
        assert torch.equal(tensor, found[name]), name


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scene(tmp_path_factory.mktemp("scene") / "box", meshes=False, states=False)


def train(scene: Path, run: Path, *more: str) -> list[str]:
    sizes = ["--steps", str(STEPS), "--points", "80"]
    return ["train", str(scene), "-o", str(run), "--model", "papr", *sizes, *ONE_THREAD, *more]


@pytest.mark.timeout(900)
def test_training_killed_three_times(scene: Path, tmp_path: Path, forked: Forked) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert main(train(scene, whole)) == 0
    moment, seen = another_moment(), list[int]()
    for resume in ((), ("--resume",), ("--resume",)):
        kill_later(forked, train(scene, broken, *resume), broken, moment)
        seen.append(RunFolder.open(broken).saved_step() or 0)
    assert main(train(scene, broken, "--resume")) == 0

    assert seen == sorted(seen)
    assert 0 < seen[-1] < STEPS
    assert RunFolder.open(broken).notes["status"] == "finished"
    assert_same_model(whole, broken)
    # The population changed along the way: to 125 to 143 points, over 6 seeds.
    assert len(load_file(whole / "model.safetensors")["cloud.positions"]) > 80


@pytest.mark.timeout(900)
def test_fine_tuning_killed(scene: Path, tmp_path: Path, forked: Forked) -> None:
    base, whole, broken = tmp_path / "base", tmp_path / "whole", tmp_path / "broken"
    settings = ["--steps", "10", "--points", "80", *ONE_THREAD]
    assert main(["train", str(scene), "-o", str(base), "--model", "papr", *settings]) == 0

    def tune(run: Path, *more: str) -> list[str]:
        steps = ["--steps", str(TUNING_STEPS)]
        return ["finetune", str(base), "-o", str(run), *steps, *ONE_THREAD, *more]

    assert main(tune(whole)) == 0
    kill_later(forked, tune(broken), broken, another_moment())
    assert 0 < (RunFolder.open(broken).saved_step() or 0) < TUNING_STEPS
    assert main(tune(broken, "--resume")) == 0
    assert_same_model(whole, broken)
