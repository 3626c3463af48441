"""What a sequence of many edits costs a picture, against the one edit that means the same.

    python benchmarks/sequence.py RUN SCENE [--factor 2] [--every 4]

A twist in many steps, each an edit of its own, against the whole twist at once: by formula, and as
displacements of the points, whose Jacobians are fitted anew at every step. PSNR in dB over all
pixels between the two pictures, and foreground PSNR of both against the truth of `twist60`.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pcore.editing.apply import deformed_cloud
from pcore.editing.session import EditSession
from pcore.evaluation.image_metrics import psnr
from pcore.evaluation.protocol import STANDARD, measure
from pcore.evaluation.states import Shot, open_states
from pcore.geometry.point_cloud import PointCloud
from pcore.model.checkpoint import SavedModel, load_model
from pcore.model.render import render

TRUTH, ANGLE = "twist60", 60.0
PLANS = ((ANGLE, 12), (120.0, 24))
"""Angle in degrees, and into how many steps it is cut."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is twisted, by how much, and who looks."""

    saved: SavedModel
    shots: Sequence[Shot]
    axis: str
    extent: list[float]
    """Along the axis, world units. Both are those of the true twist."""
    angle: float
    count: int


def main() -> None:
    """Print a line for every angle, kind of edit and kind of ray."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--factor", type=int, default=2)
    parser.add_argument("--every", type=int, default=4)
    wish = parser.parse_args()
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    saved = load_model(wish.run)
    state = open_states(wish.scene, factor=wish.factor).select([TRUTH])[1]
    record = json.loads((wish.scene / TRUTH / "deformation.json").read_text(encoding="utf-8"))
    extent = [record["driver_lo"], record["driver_hi"]]
    for angle, count in PLANS:
        plan = Plan(
            saved=saved,
            shots=state.shots[:: wish.every],
            axis=record["axis"].lower(),
            extent=extent,
            angle=angle,
            count=count,
        )
        for kind in ("twist", "displacement"):
            for aware in (True, False):
                line = compared(plan, kind, aware=aware)
                print(f"{angle:g} degrees in {count}, {kind}, {line}", flush=True)


def compared(plan: Plan, kind: str, *, aware: bool) -> str:
    """Render one edit and the sequence, and say how far they are from each other and the truth."""
    cloud, papr = plan.saved.cloud, plan.saved.papr()
    once, often = (_edited(plan, kind, steps) for steps in (1, plan.count))
    clouds = [deformed_cloud(cloud, s.state.deformation, aware=aware) for s in (once, often)]
    pictures = [[_rgb(papr, one, shot) for shot in plan.shots] for one in clouds]
    apart = statistics.mean(psnr(a, b) for a, b in zip(*pictures, strict=True))
    away = float((once.state.points - often.state.points).norm(dim=-1).max())
    line = f"{'aware' if aware else 'plain'} rays: points {away:.1e} apart, pictures {apart:.2f} dB"
    if plan.angle != ANGLE:
        return line
    scores = [_foreground(own, plan.shots) for own in pictures]
    return f"{line}; against the truth {scores[0]:.3f} dB at once, {scores[1]:.3f} dB in steps"


def _edited(plan: Plan, kind: str, count: int) -> EditSession:
    """A session in which the whole turn was done in so many edits."""
    points, angle = plan.saved.cloud.positions, plan.angle
    twist: dict[str, Any] = {"type": "twist", "axis": plan.axis, "extent": plan.extent}
    session, guide = EditSession(points), EditSession(points)
    with TemporaryDirectory() as folder:
        for number in range(count):
            before = guide.state.bound.setting.points
            guide.do({**twist, "angle_deg": angle / count})
            if kind == "twist":
                session.do({**twist, "angle_deg": angle / count})
                continue
            files = [str(Path(folder) / f"{number}_{name}.npy") for name in ("old", "new")]
            places = before, guide.state.bound.setting.points
            for file, place in zip(files, places, strict=True):
                np.save(file, place.numpy())
            session.do({"type": "displacement", "before": files[0], "after": files[1]})
    return session


def _rgb(papr: Any, cloud: PointCloud, shot: Shot) -> Tensor:
    with torch.no_grad():
        return render(papr, cloud, shot.camera).rgb.clamp(0, 1)


def _foreground(pictures: Sequence[Tensor], shots: Sequence[Shot]) -> float:
    pairs = zip(pictures, shots, strict=True)
    found = [measure(STANDARD, rgb, shot.view.rgba()).foreground_psnr for rgb, shot in pairs]
    return statistics.mean(one for one in found if one is not None)


if __name__ == "__main__":
    main()
