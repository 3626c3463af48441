"""Deformed Gaussians under the light that they tell themselves and under one that a PAPR run tells.

    python -m benchmarks.light_sources GAUSSIANS PAPR SCENE [--factor 2] [--every 1] [--states all]

Both runs are of SCENE and have a light. Only the lamps are exchanged: brightness and shape stay
those of the Gaussians. PSNR of the object in dB, mean of the views; the last column is how many
processor seconds the estimate from the Gaussians takes. The states are looked at: nothing may be
chosen on this.
"""

from __future__ import annotations

import argparse
import statistics
import time
from dataclasses import replace
from pathlib import Path

import torch
from baked_light import foreground_psnr
from true_light import solid

from pcore.asset.asset import Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.capture.load import load_scene
from pcore.evaluation.asset_method import AssetMethod
from pcore.evaluation.methods import open_subject
from pcore.evaluation.states import State, open_states
from pcore.geometry.surfels import Surfels
from pcore.relight.gaussian_light import lit_of
from pcore.relight.lamps import Light
from pcore.relight.relighting import Relighting

COLUMNS = ("light of the Gaussians", "light of PAPR", "difference")


def main() -> None:
    """Print one line per state."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name in ("gaussians", "papr", "scene"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--factor", type=int, default=2)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--states", nargs="+", default=["all"])
    wish = parser.parse_args()
    torch.set_num_threads(1)
    own, papr = open_subject(wish.gaussians), open_subject(wish.papr)
    if own.light is None or papr.light is None:
        raise SystemExit("expected two runs with a light; `pcore light` estimates it")
    other = under(own, papr.light.light)
    print(f"| {wish.scene.name} | {' | '.join(COLUMNS)} |\n|{'---|' * (len(COLUMNS) + 1)}")
    differences: list[float] = []
    for state in open_states(wish.scene, factor=wish.factor).select(wish.states):
        here, there = (score(asset, state, wish.every) for asset in (own, other))
        differences.append(here - there)
        print(f"| {state.name} | {here:.2f} | {there:.2f} | {here - there:+.2f} |", flush=True)
    print(f"| mean of the deformed | | | {statistics.mean(differences[1:]):+.2f} |")
    views = load_scene(wish.scene, factor=wish.factor).split("train")
    for view in views:
        view.rgba()
    began = time.process_time()
    content = own.content
    assert isinstance(content, GaussianContent)
    content.with_light(views)
    print(f"\nestimate from the Gaussians: {time.process_time() - began:.1f} processor seconds")


def under(asset: Asset, light: Light) -> Asset:
    """Gaussians under other lamps."""
    content = asset.content
    if not isinstance(content, GaussianContent) or content.surfels is None or asset.light is None:
        raise SystemExit(f"{asset.path}: expected a run of Gaussians with a light")
    surfels, known = content.surfels, asset.light
    lit = lit_of(surfels.normals)
    pieces = Surfels.at_rest(surfels.places[lit], surfels.normals[lit], surfels.heights[lit])
    relit = Relighting.of(light, known.positions, pieces, known.brightness, known.config)
    return replace(asset, content=replace(content, read_light=lambda: relit))


def score(asset: Asset, state: State, every: int) -> float:
    """PSNR of the object in dB over the views of a state."""
    method = AssetMethod(name="lit", asset=asset, rays="aware", light="still")
    posed = method.pose(state)
    return statistics.mean(
        foreground_psnr(solid(method.draw(posed, shot.camera).rgb), shot.view.rgba())
        for shot in state.shots[::every]
    )


if __name__ == "__main__":
    main()
