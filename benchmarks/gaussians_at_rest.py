"""Gaussians of single scenes, trained with their defaults and compared with the test photos.

    python -m benchmarks.gaussians_at_rest SCENE... [--factor N] [--steps N] [--pictures OUT]

Prints PSNR over the object's pixels and over whole pictures (protocol `standard`, mean over all
test views), on how many Gaussians, and processor seconds of the training, with one thread.
"""

from __future__ import annotations

import argparse
import statistics
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from pcore.capture.load import load_scene
from pcore.data.scene import View
from pcore.evaluation.protocol import STANDARD, ImageScores, measure
from pcore.gaussians.render import PosedGaussians, render
from pcore.kernels.memory import keep_freed_memory
from pcore.training.events import Event, ValidationReport
from pcore.training.gaussian_fit import fit_gaussians
from pcore.training.presets import gaussian_preset
from pcore.training.trainable_gaussians import TrainedGaussians


def main() -> None:
    """Train and score every scene."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--factor", type=int, default=1)
    parser.add_argument("--steps", type=int)
    parser.add_argument("--pictures", type=Path, help="folder for the first test view of each")
    wish = parser.parse_args()
    keep_freed_memory()
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    # Held-out views are to judge the end.
    config = replace(gaussian_preset("tiny"), held_out_until=None)
    if wish.steps:
        config = replace(config, steps=wish.steps)
    for path in wish.scenes:
        scene = load_scene(path, factor=wish.factor)
        held_out: list[float] = []

        def tell(event: Event, known: list[float] = held_out) -> None:
            if isinstance(event, ValidationReport):
                known.append(event.scores.get("foreground_psnr", event.psnr))

        begin = time.process_time()
        found = fit_gaussians(scene, config, listener=tell)
        seconds = time.process_time() - begin
        views = scene.split("test")
        scores = [score(found, view) for view in views]
        objects = [one.foreground_psnr for one in scores if one.foreground_psnr is not None]
        print(
            f"{scene.name}: object {statistics.mean(objects):.2f} dB, picture "
            f"{statistics.mean(one.psnr for one in scores):.2f} dB, SSIM "
            f"{statistics.mean(one.ssim for one in scores):.4f}, {len(views)} views; held-out "
            f"training views {held_out[-1] if held_out else float('nan'):.2f} dB; "
            f"{len(found.gaussians):,} Gaussians, {seconds:.0f} s",
            flush=True,
        )
        if wish.pictures:
            show(found, views[0], wish.pictures / f"{scene.name}.png")


def drawn(found: TrainedGaussians, view: View) -> torch.Tensor:
    """(H, W, 3) on white."""
    posed = PosedGaussians(gaussians=found.gaussians)
    return render(posed, [view.camera], footprint=found.footprint).rgb[0]


def score(found: TrainedGaussians, view: View) -> ImageScores:
    """Scores of a test view."""
    return measure(STANDARD, drawn(found, view), view.rgba())


def show(found: TrainedGaussians, view: View, path: Path) -> None:
    """Write truth and picture side by side."""
    both = torch.cat([view.rgb(torch.ones(3)), drawn(found, view).clamp(0, 1)], dim=1)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((both * 255).round().numpy().astype(np.uint8)).save(path)


if __name__ == "__main__":
    main()
