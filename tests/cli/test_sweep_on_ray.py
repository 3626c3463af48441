"""`pcore sweep --workers 2`: killed workers change no bit, and nothing is left running."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import pytest
from safetensors.numpy import load_file
from toys import write_scene

pytest.importorskip("ray", reason="the extra `cluster` is not installed")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(5400),
    pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads Linux's /proc"),
]

PLAN = """
version: 1
scenes: {ball: ball, other: other}
seeds: [0, 1]
settings:
  papr:
    train: {model: papr, steps: 1200, points: 60, no_tensorboard: true}
    eval: {state: ["scale:1.5"], rays: plain, protocol: standard}
  splats:
    train: {steps: 1500, points: 150, no_tensorboard: true}
    eval: {state: ["scale:1.5"], rays: plain, protocol: standard}
resources: {cpus: 1, memory_gb: 0.2}
"""
KILLS = 5


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    write_scene(tmp_path / "ball")
    write_scene(tmp_path / "other", train=14)
    path = tmp_path / "plan.yaml"
    path.write_text(PLAN, encoding="utf-8")
    return path


@contextmanager
def started(plan: Path, out: Path, *words: str) -> Generator[subprocess.Popen[bytes]]:
    """A sweep in a process of its own, which does not outlive a test that fails."""
    command = [sys.executable, "-m", "pcore.cli.main", "sweep", str(plan), "-o", str(out), *words]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def descendants(root: int) -> dict[int, str]:
    """Process ids below one, with what they call themselves."""
    parents: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parents[int(entry.name)] = int(
                    (entry / "stat").read_text().rsplit(")", 1)[1].split()[1]
                )
            except OSError:
                continue
    found, edge = set[int](), {root}
    while edge:
        edge = {child for child, parent in parents.items() if parent in edge} - found
        found |= edge
    return {one: name for one in found if (name := name_of(one))}


def name_of(process: int) -> str:
    """How a process calls itself; nothing for one that has ended."""
    try:
        return (Path("/proc") / str(process) / "cmdline").read_bytes().decode(errors="replace")
    except OSError:
        return ""


def at_work(root: int) -> list[int]:
    """Workers that have a trial."""
    return sorted(one for one, name in descendants(root).items() if name.startswith("ray::attempt"))


def in_the_middle(out: Path) -> bool:
    """Whether a trial has saved something that it can go on from, and is not finished."""
    return any(
        not (path.parent.parent / "trial.json").exists() for path in out.glob("trials/**/state.pt")
    )


def wait_until_gone(processes: dict[int, str], seconds: float = 150.0) -> dict[int, str]:
    """What is left of them in the end; two agents of Ray look for their parent once a minute."""
    end = time.monotonic() + seconds
    left = processes
    while left and time.monotonic() < end:
        time.sleep(0.5)
        left = {one: name for one, name in left.items() if name_of(one)}
    return left


def contents(out: Path) -> dict[str, bytes]:
    """Tables, scores of all pictures, and every array of models and lights."""
    tables = [*out.glob("*.csv"), *out.glob("trials/**/images.csv")]
    found = {str(path.relative_to(out)): path.read_bytes() for path in tables}
    for path in out.glob("trials/**/*.safetensors"):
        # Arrays, not files: the order of names in their headers is drawn anew for each.
        for name, array in load_file(path).items():
            found[f"{path.relative_to(out)}: {name}"] = str(array.dtype).encode() + array.tobytes()
    return found


def test_killed_workers_change_no_bit(plan: Path) -> None:
    quiet, killed = plan.parent / "quiet", plan.parent / "killed"
    with started(plan, quiet) as process:
        assert process.wait() == 0
    rng, kills, seen = random.Random(0), 0, dict[int, str]()
    with started(plan, killed, "--workers", "2") as process:
        while process.poll() is None:
            time.sleep(rng.uniform(0.1, 2.0))
            seen |= descendants(process.pid)
            workers = at_work(process.pid)
            if workers and kills < KILLS and in_the_middle(killed):
                os.kill(rng.choice(workers), signal.SIGKILL)
                kills += 1
    assert process.returncode == 0
    assert kills == KILLS
    told = "".join(path.read_text() for path in killed.glob("trials/**/output.txt"))
    assert "goes on from step" in told
    expected = contents(quiet)
    assert len(expected) > 3 + 8 * 5
    found = contents(killed)
    assert {*found} == {*expected}
    assert [name for name in expected if found[name] != expected[name]] == []
    assert not wait_until_gone(seen)


def test_nothing_outlives_a_sweep_that_is_killed(plan: Path) -> None:
    with started(plan, plan.parent / "out", "--workers", "2") as process:
        end = time.monotonic() + 300
        while not at_work(process.pid) and time.monotonic() < end:
            time.sleep(0.5)
        seen = descendants(process.pid)
    assert any(name.startswith("ray::attempt") for name in seen.values())
    assert not wait_until_gone(seen)
