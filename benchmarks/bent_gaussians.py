"""What splitting Gaussians that an edit bends inside themselves would win.

    python -m benchmarks.bent_gaussians RUN SCENE [--factor 2] [--every 4]

Every state of SCENE with a formula is drawn with affine covariances and the light baked in, from
the Gaussians as trained and from ones that were split to a tolerance (`pcore.gaussians.refine`).
PSNR of the object in dB, number of Gaussians in brackets.
"""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path

import torch
from baked_light import foreground_psnr
from true_light import solid

from pcore.asset.gaussian_content import GaussianContent
from pcore.deform.base import Deformation
from pcore.evaluation.methods import open_subject
from pcore.evaluation.states import CANONICAL, State, open_states
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.refine import bending, refined
from pcore.gaussians.render import pose, render

TOLERANCES = (None, 0.5, 0.2, 0.1)


def main() -> None:
    """Print one line per state."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name in ("run", "scene"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--factor", type=int, default=2)
    parser.add_argument("--every", type=int, default=4)
    wish = parser.parse_args()
    torch.set_num_threads(1)
    content = open_subject(wish.run).content
    if not isinstance(content, GaussianContent):
        raise SystemExit(f"{wish.run}: expected a run of Gaussians")
    columns = ["bent by more than 0.3", "as trained", *map(str, TOLERANCES[1:])]
    print(f"| {wish.scene.name} | {' | '.join(columns)} |\n|{'---|' * (len(columns) + 1)}")
    places = open_states(wish.scene, factor=wish.factor)
    if places.truth is None:
        raise SystemExit(f"{wish.scene}: no meshes.npz")
    for state in places.select(["all"]):
        map_of_space = None if state.name == CANONICAL else places.truth.analytic(state.name)
        if map_of_space is None:
            continue
        share = bending(content.gaussians, map_of_space).amax(dim=1).gt(0.3).double().mean()
        row = [f"{100 * float(share):.1f} %"]
        for tolerance in TOLERANCES:
            drawn = content.gaussians
            if tolerance is not None:
                drawn = refined(drawn, map_of_space, tolerance).gaussians
            found = score(content, drawn, map_of_space, state, wish.every)
            row.append(f"{found:.2f} ({len(drawn):,})")
        print(f"| {state.name} | {' | '.join(row)} |", flush=True)


@torch.no_grad()
def score(
    content: GaussianContent, drawn: Gaussians, moving: Deformation, state: State, every: int
) -> float:
    """PSNR of the object in dB, mean of every so-manieth view."""
    exact = drawn.means.double()
    posed = pose(drawn, moving(exact).to(drawn.means), moving.jacobian(exact).to(drawn.means))
    white = drawn.means.new_ones(3)
    return statistics.mean(
        foreground_psnr(
            solid(
                render(posed, [shot.camera], footprint=content.footprint, background=white).rgb[0]
            ),
            shot.view.rgba(),
        )
        for shot in state.shots[::every]
    )


if __name__ == "__main__":
    main()
