"""Figures of the guides: truth and methods on deformed states.

    python -m benchmarks.aware_figure OUT.png DATA RUNS scene:state:view [scene:state:view ...]
        [--methods aware "aware + light"]

RUNS holds a run NAME and its fine-tuned NAME-pcore for every scene NAME of DATA, with their lights.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from pcore.asset.asset import Asset
from pcore.evaluation.asset_method import AssetMethod
from pcore.evaluation.figures import Pixels, sheet
from pcore.evaluation.methods import open_subject
from pcore.evaluation.panels import object_window, renderings
from pcore.evaluation.runner import Taken, evaluate
from pcore.evaluation.states import open_states

METHODS = ("PAPR", "P-CORE", "aware", "aware + light")


def main() -> None:
    """Take the pictures and write one sheet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("runs", type=Path)
    parser.add_argument("shots", nargs="+")
    parser.add_argument("--methods", nargs="+", default=METHODS)
    wish = parser.parse_args()
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    rows = [
        (f"{scene}, {state}", pictures(wish, scene, state, int(view)))
        for scene, state, view in (shot.split(":") for shot in wish.shots)
    ]
    page = sheet(("truth", *wish.methods), rows, cell=180)
    Image.fromarray(page).quantize(128).save(wish.output, optimize=True)


def pictures(wish: argparse.Namespace, scene: str, state: str, view: int) -> list[Pixels | None]:
    """Truth and methods of one test view, cut to the object."""
    base, tuned = (open_subject(wish.runs / name) for name in (scene, f"{scene}-pcore"))
    methods = [_method(name, tuned if "P-CORE" in name else base) for name in wish.methods]
    chosen = open_states(wish.data / scene, factor=base.record.factor).select([state])[-1]
    chosen = replace(chosen, shots=chosen.shots[view : view + 1])
    kept: list[Taken] = []
    evaluate(methods, [chosen], show=kept.append)
    window = object_window(kept[0])
    cut = [p[window] for p in renderings(kept[0], wish.methods) if p is not None]
    return [np.ascontiguousarray(picture) for picture in cut]


def _method(name: str, asset: Asset) -> AssetMethod:
    """The method of a name, as `pcore eval` calls it."""
    return AssetMethod(
        name=name,
        asset=asset,
        rays="aware" if "aware" in name else "plain",
        light="still" if "light" in name else "baked",
    )


if __name__ == "__main__":
    main()
