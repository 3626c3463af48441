"""What deformation-aware rays cost: CPU seconds of plain and aware pictures, alternating.

python benchmarks/aware_cost.py RUN [--size 200] [--rounds 6]
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path

import torch

from pcore.deform.sampler import DeformationRanges, sample_deformation
from pcore.editing.apply import deformed_cloud
from pcore.geometry.orbit import orbit_cameras
from pcore.kernels.memory import keep_freed_memory
from pcore.model.checkpoint import load_model
from pcore.model.render import render


def main() -> None:
    """Print a JSON object: CPU seconds per picture and per edit, and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--size", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=6)
    wish = parser.parse_args()
    keep_freed_memory()
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    saved = load_model(wish.run)
    papr, cloud = saved.papr(), saved.cloud
    lower, upper = cloud.extent()
    generator = torch.Generator().manual_seed(1)
    deformation = sample_deformation(
        generator, lower, upper, cloud.positions, DeformationRanges(scale=(1.0, 1.0))
    )
    start = time.process_time()
    aware = deformed_cloud(cloud, deformation)
    edit = time.process_time() - start
    clouds = {"plain": deformed_cloud(cloud, deformation, aware=False), "aware": aware}
    distance = 2.5 * float((upper - lower).norm())
    cameras = orbit_cameras(
        0.5 * (lower + upper),
        distance,
        wish.rounds + 1,
        elevation=0.4,
        width=wish.size,
        height=wish.size,
        angle_x=0.69,
    )
    seconds: dict[str, list[float]] = {"plain": [], "aware": []}
    for camera in cameras:
        for name, one in clouds.items():
            start = time.process_time()
            render(papr, one, camera)
            seconds[name].append(time.process_time() - start)
    # The first round compiles and warms up.
    medians = {name: statistics.median(values[1:]) for name, values in seconds.items()}
    print(
        json.dumps(
            {
                "points": len(cloud),
                "size": wish.size,
                "cpu_seconds": medians,
                "ratio": medians["aware"] / medians["plain"],
                "cpu_seconds_per_edit": edit,
            },
            indent=1,
        )
    )


if __name__ == "__main__":
    main()
