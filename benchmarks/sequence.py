"""What a sequence of many edits costs a picture, against the one edit that means the same.

    python -m benchmarks.sequence RUN SCENE [--factor 2] [--every 4]

A twist in many steps, each an edit of its own, against the whole twist at once: by formula, and as
displacements of the points, whose Jacobians are fitted anew at every step. PSNR in dB over all
pixels between the two pictures, and foreground PSNR of both against the truth of `twist60`.

And edits of which many are not the same map as one: eight small drags of the point with the least x
(a hand of the knight), and eight turns of the upper half with a seam. Without a truth.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from torch import Tensor

import pcore
from pcore.asset.content import RaysName
from pcore.editing.session import EditSession
from pcore.evaluation.protocol import STANDARD, measure
from pcore.evaluation.states import Shot, open_states
from pcore.geometry.point_cloud import size_of
from pcore.metrics.image_metrics import psnr

TRUTH, ANGLE = "twist60", 60.0
PLANS = ((ANGLE, 12), (120.0, 24))
"""Angle in degrees, and into how many steps it is cut."""
RAYS: tuple[RaysName, ...] = ("aware", "plain")
SMALL = 8
"""Steps of a drag and of a turn."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is twisted, where, and who looks."""

    asset: pcore.Asset
    shots: Sequence[Shot]
    axis: str
    extent: list[float]
    """Along the axis, world units. Both are those of the true twist."""


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
    asset = pcore.load(wish.run)
    state = open_states(wish.scene, factor=wish.factor).select([TRUTH])[1]
    record = json.loads((wish.scene / TRUTH / "deformation.json").read_text(encoding="utf-8"))
    extent = [record["driver_lo"], record["driver_hi"]]
    plan = Plan(
        asset=asset,
        shots=state.shots[:: wish.every],
        axis=record["axis"].lower(),
        extent=extent,
    )
    for angle, count in PLANS:
        for kind in ("twist", "displacement"):
            for rays in RAYS:
                sessions = [_edited(plan, kind, angle, steps) for steps in (1, count)]
                line = compared(plan, sessions, rays=rays, truth=angle == ANGLE)
                print(f"{angle:g} degrees in {count}, {kind}, {line}", flush=True)
    for name, steps in (("drag", drags), ("turn with a seam", turns)):
        sessions = [_done(plan, steps(asset.points, n)) for n in (1, SMALL)]
        for rays in RAYS:
            line = compared(plan, sessions, rays=rays, truth=False)
            print(f"{name} in {SMALL}, {line}", flush=True)


def compared(plan: Plan, sessions: Sequence[EditSession], *, rays: RaysName, truth: bool) -> str:
    """Render one edit and the sequence, and say how far they are from each other and the truth."""
    asset, cameras = plan.asset, [shot.camera for shot in plan.shots]
    once, often = (session.state for session in sessions)
    # The light is baked in, so that what differs is what edits make of the surface.
    poses = [asset.pose(one, rays=rays, light="baked") for one in (once, often)]
    drawn = [asset.render(posed, cameras) for posed in poses]
    pictures = [[one.rgb.clamp(0, 1) for one in own] for own in drawn]
    apart = statistics.mean(psnr(a, b) for a, b in zip(*pictures, strict=True))
    away = (once.points - often.points).norm(dim=-1) / size_of(asset.points)
    line = (
        f"{rays} rays: points {float(away.mean()):.1e} of the size apart, "
        f"{float(away.max()):.1e} at most; pictures {apart:.2f} dB"
    )
    if not truth:
        return line
    scores = [_foreground(own, plan.shots) for own in pictures]
    return f"{line}; against the truth {scores[0]:.3f} dB at once, {scores[1]:.3f} dB in steps"


def drags(points: Tensor, count: int) -> list[dict[str, Any]]:
    """Edits that drag one point by 0.19 of the object's size, each as far as the others."""
    start = points[points[:, 0].argmin()]
    way = size_of(points) * torch.tensor([0.04, -0.11, 0.15])
    stops = [(start + way * k / count).tolist() for k in range(count + 1)]
    pairs = pairwise(stops)
    return [{"type": "anchors", "handles": [{"near": a, "to": b}]} for a, b in pairs]


def turns(points: Tensor, count: int) -> list[dict[str, Any]]:
    """Edits that turn the upper half by 40 degrees about z, with a seam of 0.2 of the size."""
    middle = 0.5 * (points.amin(dim=0) + points.amax(dim=0))
    upper = {
        "shape": "half_space",
        "normal": "z",
        "origin": middle.tolist(),
        "falloff": 0.2 * size_of(points),
    }
    turn = {"type": "rigid", "axis": "z", "origin": middle.tolist(), "region": upper}
    return [{**turn, "angle_deg": 40.0 / count}] * count


def _done(plan: Plan, edits: Sequence[dict[str, Any]]) -> EditSession:
    session = plan.asset.session()
    for edit in edits:
        session.do(edit)
    return session


def _edited(plan: Plan, kind: str, angle: float, count: int) -> EditSession:
    """A session in which the whole turn was done in so many edits."""
    twist: dict[str, Any] = {"type": "twist", "axis": plan.axis, "extent": plan.extent}
    session, guide = plan.asset.session(), plan.asset.session()
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


def _foreground(pictures: Sequence[Tensor], shots: Sequence[Shot]) -> float:
    pairs = zip(pictures, shots, strict=True)
    found = [measure(STANDARD, rgb, shot.view.rgba()).foreground_psnr for rgb, shot in pairs]
    return statistics.mean(one for one in found if one is not None)


if __name__ == "__main__":
    main()
