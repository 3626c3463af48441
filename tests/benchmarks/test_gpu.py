"""The script for a GPU machine runs on the CPU with tiny sizes, and fails where it should."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from benchmarks.__main__ import COMMANDS, main
from benchmarks.metrics import Metric, missed, read
from benchmarks.parity import measure_parity
from benchmarks.plan import Plan
from benchmarks.training_workload import _Clock

from pcore.kernels import cpu_attention
from pcore.training.events import StepReport
from tiny_scene import write_scene

PLAN = Plan(device=torch.device("cpu"), quick=True, turns=1)


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    write_scene(tmp_path / "box")
    arguments = ["benchmarks", "gpu", str(tmp_path / "box"), "--out", str(tmp_path / "gpu.json")]
    arguments += ["--quick", "--device", "cpu", "--training-seconds", "0.1"]
    monkeypatch.setattr(sys, "argv", arguments)
    return arguments


@pytest.mark.usefixtures("command")
def test_a_quick_run_on_the_cpu(tmp_path: Path) -> None:
    assert main() == 0
    found = read(tmp_path / "gpu.json")
    parts = {"parity", "loop", "training", "pictures", "search", "attention"}
    assert {name.split("/")[0] for name in found} == parts
    assert all(math.isfinite(metric.value) for metric in found.values())
    assert found["training/steps"].value >= 10
    assert found["loop/fast/milliseconds"].value > 0
    assert found["pictures/trained/fast/per_second"].value > 0
    unbounded = [n for n, m in found.items() if n.startswith("parity/") and m.bar is None]
    assert unbounded == []


def test_wrong_values_and_wrong_gradients_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert missed(dict(measure_parity(PLAN))) == []
    scores = cpu_attention.attention_scores

    def scaled(*inputs: torch.Tensor) -> torch.Tensor:
        return 1.5 * scores(*inputs)  # pyright: ignore[reportArgumentType]

    def gradient_lost(*inputs: torch.Tensor) -> torch.Tensor:
        found = scores(*inputs)  # pyright: ignore[reportArgumentType]
        return 0.5 * found + 0.5 * found.detach()

    for wrong, kind in ((scaled, "values"), (gradient_lost, "gradients")):
        monkeypatch.setattr(cpu_attention, "attention_scores", wrong)
        names = {line.split(":")[0] for line in missed(dict(measure_parity(PLAN)))}
        assert f"parity/tiny/{kind}/cpu/single" in names
        assert not any("reference" in name for name in names)


@pytest.mark.usefixtures("command")
def test_a_missed_bound_fails_the_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def wrong(plan: Plan) -> Iterator[tuple[str, Metric]]:
        yield "parity/x", Metric(value=0.2, direction="lower", tolerance=0.0, bar=0.1)

    monkeypatch.setattr("benchmarks.gpu.measure_parity", wrong)
    sys.argv += ["--only", "parity"]
    assert main() == 1
    assert "parity/x: 0.2 misses the bar of 0.1" in capsys.readouterr().err


def test_steps_are_timed_between_reports_when_they_are_warm(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock, now = _Clock(device=torch.device("cpu"), begin=0.0), [0.0]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    report = StepReport(stage="pretrain", step=0, steps=60, loss=0.0, points=1)
    for step in range(10, 61, 10):
        now[0] += 100.0 if step <= 30 else 0.5
        clock(replace(report, step=step))
    assert clock.step() == pytest.approx(0.05)


_BARE = """
import sys

class Bare:
    '''A machine without the packages of pcore that PyTorch's own image lacks, and some more.'''

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {"tyro", "trimesh", "rich", "yaml", "embreex", "imageio", "av",
                                  "tensorboard", "jinja2", "matplotlib", "skimage", *sys.argv[1:]}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return None

sys.meta_path.insert(0, Bare())
sys.path.insert(0, ".")
gone = sys.argv[1:]
from benchmarks import __main__ as command
if gone:
    command.find_spec = lambda name: None if name in gone else object()
    sys.exit(command.main())
sys.argv[1:] = ["gpu", "--help"]
command.main()
"""


def bare(*gone: str) -> subprocess.CompletedProcess[str]:
    root = Path(__file__).parents[2]
    return subprocess.run(
        [sys.executable, "-c", _BARE, *gone], cwd=root, capture_output=True, text=True, check=False
    )


def test_it_needs_no_more_than_it_says() -> None:
    shown = bare()
    assert shown.returncode == 0, shown.stderr
    assert "--training-seconds" in shown.stdout


def test_unknown_commands_are_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["benchmarks", "gpus"])
    assert main() == 2
    assert "expected speed, scaling, bars, captures or gpu, got 'gpus'" in capsys.readouterr().err


def test_missing_packages_are_named() -> None:
    shown = bare("pydantic", "PIL")
    assert shown.returncode == 2
    assert "missing packages: pillow, pydantic; install them, or bring" in shown.stderr


def test_help_lists_every_command_and_every_program(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["benchmarks", "--help"])
    assert main() == 0
    shown = capsys.readouterr().out
    commands, programs = shown.split("\n\n")
    assert [line.split()[0] for line in commands.splitlines()[1:]] == list(COMMANDS)
    assert {"paper", "skinning", "sequential_edits"} <= {
        line.split()[0] for line in programs.splitlines()[1:]
    }
    assert all(len(line.split()) > 4 for line in shown.splitlines() if line.startswith("  "))
