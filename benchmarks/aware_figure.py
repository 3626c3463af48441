"""The figure of docs/guide/deformation-aware.md: truth and the four methods on deformed states.

    python benchmarks/aware_figure.py OUT.png DATA RUNS scene:state:view [scene:state:view ...]

RUNS holds a run NAME and its fine-tuned NAME-pcore for every scene NAME of DATA.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from pcore.cli.models import open_run
from pcore.evaluation.figures import Pixels, sheet
from pcore.evaluation.panels import object_window, renderings
from pcore.evaluation.runner import Method, Taken, evaluate
from pcore.evaluation.states import open_states
from pcore.model.render import render

METHODS = ("PAPR", "P-CORE", "aware", "aware + P-CORE")


def main() -> None:
    """Take the pictures and write one sheet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("runs", type=Path)
    parser.add_argument("shots", nargs="+")
    wish = parser.parse_args()
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    rows = [
        (f"{scene}, {state}", pictures(wish.data / scene, wish.runs, state, int(view)))
        for scene, state, view in (shot.split(":") for shot in wish.shots)
    ]
    page = sheet(("truth", *METHODS), rows, cell=180)
    Image.fromarray(page).quantize(128).save(wish.output, optimize=True)


def pictures(scene: Path, runs: Path, state: str, view: int) -> list[Pixels | None]:
    """Truth and methods of one test view, cut to the object."""
    plain = [open_run(runs / name) for name in (scene.name, f"{scene.name}-pcore")]
    methods = [
        Method(name=METHODS[i + 2 * aware], papr=run.papr, cloud=run.cloud, aware=bool(aware))
        for aware in (0, 1)
        for i, run in enumerate(plain)
    ]
    chosen = open_states(scene, factor=plain[0].factor).select([state])[-1]
    chosen = replace(chosen, shots=chosen.shots[view : view + 1])
    kept: list[Taken] = []
    evaluate(methods, [chosen], draw=render, show=kept.append)
    window = object_window(kept[0])
    cut = [p[window] for p in renderings(kept[0], METHODS) if p is not None]
    return [np.ascontiguousarray(picture) for picture in cut]


if __name__ == "__main__":
    main()
