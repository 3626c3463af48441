"""Dragging in a session: from the second preview on, only places are computed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
import trimesh
from torch import Tensor

from benchmarks import scenes
from benchmarks.measure import seconds
from benchmarks.metrics import Metric
from benchmarks.plan import Plan
from pcore.editing.session import EditSession

_SECOND, _FIRST = 0.030, 10.0
"""Seconds that were promised: of a drag, and of binding."""


def measure_drag(plan: Plan) -> Iterator[tuple[str, Metric]]:
    """Previews of a cage and of an anchor through `EditSession`; the first of each binds."""
    count = 300 if plan.quick else 30_000
    points = scenes.cloud(count)
    with TemporaryDirectory() as folder:
        makers = {"cage": _Cage(points, Path(folder)), "anchor": _Anchor(points)}
        for name, maker in makers.items():
            session = EditSession(points)
            first = seconds(lambda s=session, m=maker: s.preview(m.edit(0.01)))
            later = [
                seconds(lambda s=session, m=maker, i=i: s.preview(m.edit(0.02 + 0.01 * i)))
                for i in range(plan.turns)
            ]
            middle = float(torch.tensor(later).median())
            full = not plan.quick
            yield f"drag/{name}/{count}/bind", _time(first, _FIRST if full else None)
            yield f"drag/{name}/{count}/seconds", _time(middle, _SECOND if full else None)


class _Cage:
    """A ball of 530 vertices around the points, blown up."""

    def __init__(self, points: Tensor, folder: Path) -> None:
        radius = 1.1 * float(points.norm(dim=1).max()) / math.cos(math.pi / 22)
        mesh: Any = trimesh.creation.uv_sphere(radius=radius, count=[23, 11])
        self.file = folder / "cage.ply"
        mesh.export(self.file)
        self.vertices = torch.tensor(mesh.vertices, dtype=torch.float64)

    def edit(self, step: float) -> dict[str, Any]:
        after = (self.vertices * (1 + step)).tolist()
        return {"type": "cage", "before": str(self.file), "after": after}


class _Anchor:
    """The farthest point, pulled outwards."""

    def __init__(self, points: Tensor) -> None:
        self.place = points[int(points.norm(dim=1).argmax())]

    def edit(self, step: float) -> dict[str, Any]:
        handle = {"near": self.place.tolist(), "to": (self.place * (1 + step)).tolist()}
        return {"type": "anchors", "handles": [handle]}


def _time(value: float, bar: float | None) -> Metric:
    return Metric(value=value, direction="lower", tolerance=3.0, bar=bar, unit=" s")
