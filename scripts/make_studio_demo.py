"""Make the small object that `pcore studio --demo` opens: Gaussians of the embedded sample.

Writes `src/pcore/studio/demo_run/`, at most 300 kB, package data. Takes minutes on two cores.
"""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import pcore
from pcore.files.run_record import RunRecord
from pcore.sample.sample import make_sample
from pcore.training.gaussian_config import DensityConfig, GaussianConfig

TARGET = Path(__file__).resolve().parent.parent / "src" / "pcore" / "studio" / "demo_run"
LARGEST = 300_000
SETTINGS = GaussianConfig(
    steps=2400, points=1500, degree=1, density=DensityConfig(limit=2000), background="white"
)


def main() -> None:
    """Train, estimate the light, keep what drawing needs."""
    with tempfile.TemporaryDirectory() as scratch:
        scene = pcore.load_scene(make_sample(Path(scratch) / "sample", resolution=200))
        run = Path(scratch) / "run"
        # Without a record of where it was made: that folder is gone.
        made = replace(pcore.train(scene, SETTINGS), record=RunRecord(stage="pretrain"))
        asset = made.save(run)
        TARGET.mkdir(parents=True, exist_ok=True)
        for name in ("run.json", "gaussians.safetensors", "light.safetensors"):
            shutil.copyfile(run / name, TARGET / name)
    total = sum(file.stat().st_size for file in TARGET.iterdir())
    print(f"{TARGET.name}: {len(asset):,} Gaussians, {total / 1000:.0f} kB")
    if total > LARGEST:
        raise SystemExit(f"{TARGET}: expected at most {LARGEST} bytes, got {total}")


if __name__ == "__main__":
    main()
