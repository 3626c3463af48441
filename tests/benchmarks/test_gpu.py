"""The script for a GPU machine runs on the CPU with tiny sizes and fills every part of its file."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import pytest
from benchmarks.__main__ import main

from tiny_scene import write_scene


def test_a_quick_run_on_the_cpu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_scene(tmp_path / "box")
    out = tmp_path / "gpu.json"
    arguments = ["--quick", "--device", "cpu", "--factor", "1", "--training-seconds", "0.1"]
    monkeypatch.setattr(
        sys, "argv", ["benchmarks", "gpu", str(tmp_path / "box"), "--out", str(out), *arguments]
    )
    assert main() == 0
    found = json.loads(out.read_text(encoding="utf-8"))
    parts = {"parity", "speed", "attention", "step", "training", "rendering"}
    assert {*found} == {"machine", "seconds"} | parts
    assert found["machine"]["kernels"] == "cpu"
    assert found["parity"]["same_as_cpu/camera"] == 1.0
    assert found["parity"]["as_reference/near_surface"] > 0.95
    assert found["parity"]["features"] < 1e-5
    assert found["attention"]["gradients/cpu/single"] < 1e-4
    assert found["attention"]["both/cpu/single"] > 0
    assert found["training"]["steps"] >= 30
    assert all(math.isfinite(psnr) for psnr in found["training"]["psnr"].values())
    assert found["rendering"]["pictures_per_second"] > 0
