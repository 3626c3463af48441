"""Train PAPR on a scene from Python, with a listener of your own.

    python examples/01_train.py SCENE RUN --steps 300

RUN is a run like those of `pcore train`: the other examples and every command read it.
"""

from dataclasses import replace
from pathlib import Path

import tyro

import pcore
from pcore.training.events import Event, StepReport, ValidationReport


class Watch:
    """A listener is anything that can be called with an event; this one keeps the curves."""

    def __init__(self) -> None:
        self.losses: list[tuple[int, float]] = []
        self.validation: list[tuple[int, float]] = []

    def __call__(self, event: Event) -> None:
        """Keep and show what a training loop tells."""
        if isinstance(event, StepReport):
            self.losses.append((event.step, event.loss))
            terms = ", ".join(f"{name} {value:.4f}" for name, value in event.losses.items())
            print(f"step {event.step} of {event.steps}: {event.points} points, {terms}")
        elif isinstance(event, ValidationReport):
            self.validation.append((event.step, event.psnr))
            print(f"step {event.step}: {event.psnr:.2f} dB on {event.views} held-out views")


def main(scene: Path, run: Path, /, steps: int = 300, factor: int = 1) -> None:
    """Train the preset `tiny` for a few steps.

    Args:
        scene: folder in the NeRF-Synthetic layout (docs/guide/scenes.md).
        run: folder to make.
        steps: optimiser steps; the preset has more.
        factor: down-scale images by this whole number.
    """
    views = pcore.load_scene(scene, factor=factor)
    config = replace(pcore.preset("tiny"), steps=steps, validate_every=max(1, steps // 3))
    watch = Watch()
    options = pcore.RunOptions(note=print)  # Says why, where the light cannot be estimated.
    asset = pcore.train(views, config, folder=run, listener=watch, options=options)
    first, last = watch.losses[0][1], watch.losses[-1][1]
    print(f"{len(asset)} points; loss {first:.4f} -> {last:.4f}; saved in {run}")


if __name__ == "__main__":
    tyro.cli(main)
