"""How well frames are estimated where an object is torn apart: the error at the seam of two parts.

    python -m benchmarks.torn_frames RUN [RUN ...]

The points on one side of a plane through the object are turned and moved away, the others stay, so
every true frame is known. Printed is |A - A_true| (Frobenius) of the points within 0.06 world units
of the plane: mean / 99th percentile. Five cuts, none of them a state of the evaluation.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import torch
from torch import Tensor

import pcore
from pcore.deform.jacobian import estimated_maps

CUTS = (
    (0, 0.35, 50, (0.0, 0.0, 0.0)),
    (2, 0.2, 35, (0.0, 0.0, 0.1)),
    (0, -0.3, 60, (-0.1, 0.1, 0.0)),
    (2, -0.3, 80, (0.0, 0.0, -0.2)),
    (1, 0.0, 25, (0.0, 0.15, 0.0)),
)
"""Axis of the plane's normal, its place, the turn in degrees about the axis two on, the shift."""
_SEAM = 0.06


def main() -> None:
    """Print a row per run and a column per cut."""
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        raise SystemExit(__doc__)
    for run in sys.argv[1:]:
        points = pcore.load(run).points.double()
        row = [seam_errors(points, *cut) for cut in CUTS]
        cells = [f"{float(one.mean()):.2f} / {float(one.quantile(0.99)):.1f}" for one in row]
        print(f"| {Path(run).name} | {' | '.join(cells)} |", flush=True)


def seam_errors(
    points: Tensor, axis: int, place: float, degrees: float, shift: tuple[float, float, float]
) -> Tensor:
    """Errors of the frames near the plane, (M,)."""
    turn = torch.eye(3, dtype=torch.float64)
    other, angle = (axis + 1) % 3, math.radians(degrees)
    turn[axis, axis] = turn[other, other] = math.cos(angle)
    turn[axis, other], turn[other, axis] = -math.sin(angle), math.sin(angle)
    pivot = torch.zeros(3, dtype=torch.float64)
    pivot[axis] = place
    part = points[:, axis] > place
    gone = (points - pivot) @ turn.T + pivot + torch.tensor(shift, dtype=torch.float64)
    frames = estimated_maps(points, torch.where(part[:, None], gone, points))
    still = torch.eye(3, dtype=torch.float64)
    true = torch.where(part[:, None, None], turn, still)
    wrong = (torch.linalg.inv(frames.to_rest.double()) - true).norm(dim=(1, 2))
    return wrong[(points[:, axis] - place).abs() < _SEAM]


if __name__ == "__main__":
    main()
