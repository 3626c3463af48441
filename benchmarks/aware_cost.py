"""What deformation-aware rays cost: CPU seconds of plain and aware pictures, in turns, one thread.

Where the run has a light, of pictures in that light as well ("lit").

python -m benchmarks.aware_cost RUN SCENE [--factor 2] [--rounds 8] [--states run twist60]
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path

import torch

import pcore
from pcore.evaluation.states import State, open_states
from pcore.kernels.memory import keep_freed_memory


def main() -> None:
    """Print a JSON object: by state, CPU seconds per picture and per edit, and ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--factor", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--states", nargs="+", default=["all"])
    wish = parser.parse_args()
    keep_freed_memory()
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    asset = pcore.load(wish.run)
    states = open_states(wish.scene, factor=wish.factor).select(wish.states)[1:]
    found = {state.name: measure(asset, state, wish.rounds) for state in states}
    print(json.dumps(found, indent=1))


def measure(asset: pcore.Asset, state: State, rounds: int) -> dict[str, float]:
    """Medians over test cameras of a state; ratios are those of pictures drawn in turn."""
    moved = state.move(asset.points)
    start = time.process_time()
    maps = state.local_maps(asset.points, moved)
    edits = {"local maps": time.process_time() - start}
    motion = pcore.MovedPoints(positions=moved, local_maps=maps, world=state.world)
    poses = {
        "plain": asset.pose(motion, rays="plain", light="baked"),
        "aware": asset.pose(motion, light="baked"),
    }
    if asset.light is not None:
        # The first edit computes the light of the rest state as well, and compiles.
        for name in ("first light", "light"):
            start = time.process_time()
            poses["lit"] = asset.pose(motion, light="still")
            edits[name] = time.process_time() - start
    seconds: dict[str, list[float]] = {name: [] for name in poses}
    for shot in [state.shots[turn % len(state.shots)] for turn in range(rounds + 1)]:
        for name, posed in poses.items():
            start = time.process_time()
            asset.render(posed, shot.camera)
            seconds[name].append(time.process_time() - start)
    # The first round compiles and warms up.
    found = {name: statistics.median(values[1:]) for name, values in seconds.items()}
    for name in [one for one in poses if one != "plain"]:
        pairs = zip(seconds[name][1:], seconds["plain"][1:], strict=True)
        # Of a machine that is now faster, now slower, the same moment is compared.
        found[f"{name} / plain"] = statistics.median(one / plain for one, plain in pairs)
    return {**found, **edits}


if __name__ == "__main__":
    main()
