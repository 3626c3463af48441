"""What deformation-aware rays cost: CPU seconds of plain and aware pictures, in turns, one thread.

python benchmarks/aware_cost.py RUN SCENE [--factor 2] [--rounds 8] [--states run twist60]
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path

import torch

from pcore.evaluation.states import State, open_states
from pcore.kernels.memory import keep_freed_memory
from pcore.model.checkpoint import SavedModel, load_model
from pcore.model.render import render


def main() -> None:
    """Print a JSON object: by state, CPU seconds per picture and per edit, and the ratio."""
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
    saved = load_model(wish.run)
    states = open_states(wish.scene, factor=wish.factor).select(wish.states)[1:]
    print(json.dumps({s.name: measure(saved, s, wish.rounds) for s in states}, indent=1))


def measure(saved: SavedModel, state: State, rounds: int) -> dict[str, float]:
    """Medians over test cameras of a state; the ratio is that of two pictures drawn in turn."""
    papr, rest = saved.papr(), saved.cloud
    moved = state.move(rest.positions)
    start = time.process_time()
    frames = state.frames(rest.positions, moved)
    edit = time.process_time() - start
    clouds = {"plain": rest.moved(moved), "aware": rest.moved(moved, frames)}
    seconds: dict[str, list[float]] = {"plain": [], "aware": []}
    for shot in [state.shots[turn % len(state.shots)] for turn in range(rounds + 1)]:
        for name, cloud in clouds.items():
            start = time.process_time()
            render(papr, cloud, shot.camera)
            seconds[name].append(time.process_time() - start)
    # The first round compiles and warms up.
    medians = {name: statistics.median(values[1:]) for name, values in seconds.items()}
    pairs = zip(seconds["aware"][1:], seconds["plain"][1:], strict=True)
    # Of a machine that is now faster, now slower, the same moment is compared.
    ratio = statistics.median(aware / plain for aware, plain in pairs)
    return {**medians, "ratio": ratio, "frames": edit}


if __name__ == "__main__":
    main()
