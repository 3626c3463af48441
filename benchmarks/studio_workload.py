"""What a hand on the studio's page waits for: the server's processor time, memory, and its bars."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
import trimesh
from torch import Tensor

from benchmarks import scenes
from benchmarks.measure import in_turns, seconds
from benchmarks.metrics import Metric
from benchmarks.papr_workloads import sharpened
from benchmarks.plan import Plan
from pcore.deform.jacobian import fitted_maps
from pcore.deform.pose import pose
from pcore.editing.session import EditSession
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint
from pcore.gaussians.render import pose as carry
from pcore.gaussians.render import render as draw
from pcore.gaussians.splats import SplatsAtRest
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras
from pcore.render.picture import FAST_THRESHOLD, render
from pcore.studio.page_frame import PageFrame
from pcore.training.presets import preset

_EVENT = {4_000: 0.015, 30_000: 0.030}
_PICTURE = {100: 0.060, 200: 0.150}
_FRAMES, _COMMIT, _REFINED = 0.005, 0.100, 1.2
_START, _MEGABYTES, _GROWTH = 6.0, 600.0, 0.05
"""What was promised: seconds, megabytes, and the share by which hours of editing may grow."""
_COMMANDS = 20_000
"""About two hours of a person who does three things a second."""
_POINTS, _PHOTO = 4_000, 100
"""Of the pictures: points of the preset `tiny`, and pixels of its photos."""
_EYE = torch.tensor([2.0, -2.0, 1.0])
_KINDS = ("twist", "anchors", "part", "cage", "mesh", "displacement")

Make = Callable[[float], dict[str, Any]]


def measure_studio(plan: Plan) -> Iterator[tuple[str, Metric]]:
    """All budgets of the page: events of drags, stacks, commits, pictures, start, memory."""
    with TemporaryDirectory() as folder:
        for count in (300,) if plan.quick else (4_000, 30_000):
            yield from _drags(count, Path(folder), plan)
    yield from _stack(300 if plan.quick else 4_000, plan)
    yield from _pictures(plan)
    yield from _pictures_of_gaussians(plan)
    yield from _server(plan)


def _drags(count: int, folder: Path, plan: Plan) -> Iterator[tuple[str, Metric]]:
    """A drag event: where the points go, how space moves there, splats, and the page's bytes."""
    points = scenes.cloud(count)
    splats, frame = SplatsAtRest.of(_gaussians(points)), PageFrame.around(points)
    for kind, make in _edits(points, folder).items():
        session = EditSession(points)
        session.do({"type": "scale", "factor": 1.1})
        session.do(make(0.01))
        session.warm(make(0.015), at=1)

        def event(step: int, session: EditSession = session, make: Make = make) -> None:
            state = session.preview(make(0.02 + 0.01 * step), at=1, frames="quick")
            moved = splats.moved(state.points, state.bound.linear, _EYE)
            frame.buffer(moved)

        event(-1)
        times = [seconds(lambda step=step, event=event: event(step)) for step in range(plan.turns)]
        yield f"studio/drag/{kind}/{count}/seconds", _time(times, _EVENT.get(count), plan)
        last = make(0.01 + 0.01 * plan.turns)
        commit = seconds(lambda s=session, edit=last: s.replace(1, edit, merge="drag"))
        if count == 4_000 or plan.quick:
            yield f"studio/commit/{kind}/{count}/seconds", _time([commit], _COMMIT, plan)


def _edits(points: Tensor, folder: Path) -> dict[str, Make]:
    """What is dragged, by how far. All are second in a stack, after an even scale by 1.1."""
    here = 1.1 * points
    top = here[int(here[:, 2].argmax())]
    ball: Any = trimesh.creation.icosphere(2, radius=1.15 * float(here.norm(dim=1).max()))
    inner: Any = trimesh.creation.icosphere(3, radius=0.6)
    rest = {"cage": ball, "mesh": inner}
    for name, mesh in rest.items():
        mesh.export(folder / f"{name}.ply")
    np.save(folder / "before.npy", here.double().numpy())

    def shape(kind: str, step: float) -> dict[str, Any]:
        after = rest[kind].vertices.copy()
        after[:, 0] += step * np.sin(2 * after[:, 2])
        return {"type": kind, "before": str(folder / f"{kind}.ply"), "after": after.tolist()}

    def displaced(step: float) -> dict[str, Any]:
        after = here.double().numpy().copy()
        after[:, 0] += step * np.sin(2 * after[:, 2])
        name = folder / f"after-{step:.3f}.npy"
        np.save(name, after)
        before = str(folder / "before.npy")
        return {"type": "displacement", "before": before, "after": str(name)}

    def dragged(step: float) -> dict[str, Any]:
        handle = {"near": top.tolist(), "to": (top * (1 + step)).tolist()}
        return {"type": "anchors", "handles": [handle]}

    def twisted(step: float) -> dict[str, Any]:
        return {"type": "twist", "axis": "z", "angle_deg": 100 * step}

    region = {"shape": "geodesic", "center": top.tolist(), "radius": 0.3, "falloff": 0.3}
    makers: tuple[Make, ...] = (
        twisted,
        dragged,
        lambda step: {**twisted(step), "region": region},
        lambda step: shape("cage", step),
        lambda step: shape("mesh", step),
        displaced,
    )
    return dict(zip(_KINDS, makers, strict=True))


def _stack(count: int, plan: Plan) -> Iterator[tuple[str, Metric]]:
    """Frames of ten edits after the last one changed, and what differs from a fresh computation."""
    points = scenes.cloud(count)
    session = EditSession(points)
    for _ in range(10):
        session.do({"type": "twist", "axis": "z", "angle_deg": 3})

    def changed(step: int) -> object:
        edit = {"type": "twist", "axis": "z", "angle_deg": 4 + step}
        return session.preview(edit, at=9).bound.linear

    changed(-1)
    times = [seconds(lambda step=step: changed(step)) for step in range(plan.turns)]
    yield f"studio/stack/{count}/seconds", _time(times, _FRAMES, plan)
    last = session.preview({"type": "twist", "axis": "z", "angle_deg": 5}, at=9)
    fresh = EditSession(points, last.script).state
    differing = int((fresh.bound.linear != last.bound.linear).sum())
    differing += int((fresh.points != last.points).sum())
    yield (
        f"studio/stack/{count}/differing",
        Metric(value=differing, direction="lower", tolerance=0.0, bar=0.0),
    )
    quick = _quick_error(points)
    yield (
        f"studio/frames/{count}/quick_error",
        Metric(value=quick, direction="lower", tolerance=1.0),
    )


def _quick_error(points: Tensor) -> float:
    """Median difference of quick frames of a displacement from those fitted with care."""
    after = points.clone()
    after[:, 0] += 0.2 * torch.sin(2 * after[:, 2])
    with TemporaryDirectory() as folder:
        paths = [Path(folder) / name for name in ("before.npy", "after.npy")]
        for path, places in zip(paths, (points, after), strict=True):
            np.save(path, places.numpy())
        before, then = map(str, paths)
        edit = {"type": "displacement", "before": before, "after": then}
        quick = EditSession(points).preview(edit, frames="quick").bound.linear
    return float((quick - fitted_maps(points, after)[0]).norm(dim=(1, 2)).median())


@torch.no_grad()
def _pictures(plan: Plan) -> Iterator[tuple[str, Metric]]:
    """Pictures while something moves and at rest, of networks that were not trained, twisted.

    The photos are 100 pixels wide. The first refined one is 200 wide and exact, of four rays.
    """
    count = 300 if plan.quick else _POINTS
    config = preset("tiny").model
    points = scenes.cloud(count)
    camera = _camera(points, 16 if plan.quick else _PHOTO)
    depth = float(camera.depth(points).median())
    spacing = float(points.norm(dim=1).max()) / math.sqrt(count)
    config = replace(config, pixel=depth / camera.focal[0], cutoff=4.0 * spacing)
    papr, cloud = scenes.papr(config, points, plan.device)
    cloud, _ = sharpened(papr, cloud, camera.rays())
    for parameter in papr.parameters():
        parameter.requires_grad_(False)
    session = EditSession(points)
    state = session.do({"type": "twist", "axis": "z", "angle_deg": 40})
    posed = pose(_plain(cloud), state.bound.known)
    for size in (16,) if plan.quick else tuple(_PICTURE):
        view = _camera(points, size)
        found = in_turns(
            {"": lambda view=view: render(papr, posed, view, threshold=FAST_THRESHOLD, samples=1)},
            plan.turns,
        )[""]
        bar = _PICTURE.get(size)
        yield f"studio/picture/moving/{size}/seconds", _time([found], bar, plan)
    size = 16 if plan.quick else 200
    view = _camera(points, size)
    exact = seconds(lambda: render(papr, posed, view, samples=4))
    yield f"studio/picture/refined/{size}/seconds", _time([exact], _REFINED, plan)


@torch.no_grad()
def _pictures_of_gaussians(plan: Plan) -> Iterator[tuple[str, Metric]]:
    """Exact pictures while something moves: how space moves, Gaussians, a picture."""
    count = 300 if plan.quick else 10_000
    points = scenes.cloud(count)
    gaussians, session = _gaussians(points), EditSession(points)
    session.do({"type": "twist", "axis": "z", "angle_deg": 40})
    for size in (16,) if plan.quick else tuple(_PICTURE):
        view = _camera(points, size)

        def picture(step: int, view: Camera = view) -> None:
            edit = {"type": "twist", "axis": "z", "angle_deg": 40 + step}
            state = session.preview(edit, at=0, frames="quick")
            drawn = carry(gaussians, state.points.float(), state.bound.linear)
            draw(drawn, [view], footprint=Footprint())

        picture(-1)
        times = [seconds(lambda step=step, one=picture: one(step)) for step in range(plan.turns)]
        bar = _PICTURE.get(size)
        yield f"studio/picture/moving/gaussians/{size}/seconds", _time(times, bar, plan)


def _plain(cloud: Any) -> Any:
    return replace(
        cloud,
        positions=cloud.positions.detach(),
        features=cloud.features.detach(),
        influence=cloud.influence.detach(),
    )


def _camera(points: Tensor, size: int) -> Camera:
    """Look at the whole object, which fills the picture, as the page does at first."""
    away = 1.5 * float((points.amax(dim=0) - points.amin(dim=0)).norm())
    return orbit_cameras(
        torch.zeros(3), away, 8, elevation=0.45, width=size, height=size, angle_x=0.7
    )[1]


def _server(plan: Plan) -> Iterator[tuple[str, Metric]]:
    """A page's server in a process of its own; see `benchmarks.studio_server`."""
    commands = 500 if plan.quick else _COMMANDS
    words = [sys.executable, "-m", "benchmarks.studio_server", str(commands)]
    outcome = subprocess.run(
        words,
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    found = json.loads(outcome.stdout.splitlines()[-1])
    yield "studio/start/seconds", _time([found["start"]], _START, plan)
    for name, value, bar, unit in (
        ("memory", found["megabytes"], _MEGABYTES, " MB"),
        ("growth", found["growth"], _GROWTH, ""),
    ):
        barred = None if plan.quick else bar
        metric = Metric(value=value, direction="lower", tolerance=0.2, bar=barred, unit=unit)
        yield f"studio/server/{name}", metric


def _gaussians(points: Tensor) -> Gaussians:
    """Round ones at the points, with colours of degree 3."""
    count, source = len(points), torch.Generator().manual_seed(0)
    quats = torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1)
    return Gaussians(
        means=points,
        quats=quats,
        scales=torch.full((count, 3), 0.01),
        opacities=torch.full((count,), 0.8),
        sh=0.1 * torch.randn(count, 16, 3, generator=source),
    )


def _time(values: list[float], bar: float | None, plan: Plan) -> Metric:
    middle = float(np.median(values))
    limit = bar if plan.bars else None
    return Metric(value=middle, direction="lower", tolerance=3.0, bar=limit, unit=" s")
