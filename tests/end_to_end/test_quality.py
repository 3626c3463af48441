"""Whole trainings with the presets that users get; minutes each, so only on demand."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pcore.cli.main import main


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "psnr"), [("lego", 25.0), ("chair", 28.0)])
def test_tiny_learns_real_images(
    scene: str, psnr: float, shared_data: Path, tmp_path: Path
) -> None:
    """Mean over the 50 test views, 100 x 100 pixels; docs/research/quality.md has the figures."""
    run = tmp_path / scene
    source = str(shared_data / "nerf_synthetic" / scene)
    assert (
        main(
            ["train", source, "-o", str(run), "--model", "papr", "--factor", "4", "--device", "cpu"]
        )
        == 0
    )
    assert main(["eval", str(run), "--device", "cpu"]) == 0
    means = json.loads((run / "eval" / "summary.json").read_text())["means"]
    (found,) = (m for m in means if (m["method"], m["state"]) == ("PAPR", "canonical"))
    assert found["scores"]["psnr"] >= psnr
