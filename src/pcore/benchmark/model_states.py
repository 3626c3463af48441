"""What states a benchmark shows of a model: formulas, edit files, and times of its clips."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch

from pcore.benchmark.long_triangles import long_triangles
from pcore.benchmark.look import FloatArray
from pcore.benchmark.model import Model
from pcore.benchmark.renderers import RendererName
from pcore.deform.base import Deformation
from pcore.editing.script import EditScript
from pcore.errors import InputError
from pcore.sample.sample_states import (
    ANGLE_X,
    Axis,
    DeformedState,
    deformed_states,
    describe_state,
)

Light = Literal["fixed", "baked"]
_Pose = tuple[str, float, FloatArray]
"""Clip, time, vertices (V, 3)."""

CAMERA_RADIUS = 4.0
"""Distance of the cameras from the middle of the canonical shape, in its radii."""
_FARTHEST = 2.8
"""Largest norm of a vertex that is sure to be in the widened pictures of every camera: a ball of
radius r is in them while r <= sqrt(R^2 - 1 / tan(angle_x / 2)^2), R the cameras' distance."""

_LOOKS = 24
"""Times of a clip among which that is taken whose shape differs most from the canonical one."""
_RESERVED = re.compile(r"|canonical|faces|cut_out|(train|val|test)(_geometry)?|sample_.*")
"""Arrays of `meshes.npz` and folders that are not states."""
_UNFIT = re.compile(r"[^A-Za-z0-9_.-]+")
_FLAT = 1e-9
"""Area of a surface that is a line, in squares of its radius."""
_GONE = 1e-3
"""Extent, in radii of the object, under which a clip or an edit has made it vanish."""
_SMALL = 0.2
"""Extent, in that of the canonical shape, under which pictures hardly show a state."""
_STILL = 1e-4
"""Mean displacement, in radii of the object, under which a clip does not move."""


@dataclass(frozen=True, kw_only=True)
class BenchmarkPlan:
    """What to make of a model.

    Attributes:
        resolution: pixels along each side.
        train_views: canonical training views.
        test_views: test views, canonical and of every state.
        state_train_views: training views of every state, for methods that learn it from photos.
        light: "fixed": it stands still while the object moves; "baked": it sticks to the surface.
        renderer: who takes the pictures.
        analytic: make twist60, bend60, stretch and scale2x.
        bend_axis: about which bend60 bends; None: z for a long x, y for a long z.
        edits: name -> edit file, each a state.
        clips: (clip, time) of states; a time of None is that which differs most.
        every_clip: make a state of each clip.
        canonical: (clip, time) of the canonical shape; None: as the file stands.
        seed: of the samples of the surface.
    """

    resolution: int = 200
    train_views: int = 100
    test_views: int = 20
    state_train_views: int = 0
    light: Light = "fixed"
    renderer: RendererName = "embedded"
    analytic: bool = True
    bend_axis: Axis | None = None
    edits: tuple[tuple[str, EditScript], ...] = ()
    clips: tuple[tuple[str, float | None], ...] = ()
    every_clip: bool = True
    canonical: tuple[str, float] | None = None
    seed: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """A state to make.

    Attributes:
        vertices: (V, 3) of its mesh.
        angle_x: horizontal field of view, radians, in which it fits.
        description: content of `deformation.json`.
    """

    vertices: FloatArray
    angle_x: float
    description: dict[str, Any]


def canonical_shape(model: Model, plan: BenchmarkPlan) -> tuple[FloatArray, FloatArray, float]:
    """Canonical vertices of largest norm 1 about the middle of their box.

    Returns:
        Vertices (V, 3), the middle (3,) and the factor: (model - middle) * factor.

    Raises:
        InputError: a clip that is not there, or a shape without extent.
    """
    raw = model.vertices
    if plan.canonical is not None:
        raw = model.at(model.clip(plan.canonical[0]), plan.canonical[1])
    used = raw[np.unique(model.faces)]
    center = 0.5 * (used.min(axis=0) + used.max(axis=0))
    radius = float(np.linalg.norm(used - center, axis=1).max())
    if not 0 < radius < math.inf:
        raise InputError(
            f"{model.name}: expected a shape of some extent, got one of radius {radius:g}"
        )
    corners = (raw[model.faces] - center) / radius
    sides = corners[:, 1:] - corners[:, :1]
    if not np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() > _FLAT:
        raise InputError(f"{model.name}: expected a surface, got triangles without any area")
    return (raw - center) / radius, center, 1.0 / radius


def plan_states(
    model: Model, plan: BenchmarkPlan, vertices: FloatArray, center: FloatArray, scale: float
) -> tuple[dict[str, State], list[str]]:
    """Move the canonical vertices (V, 3) into every state; say what was left out.

    Raises:
        EditError: an edit that does not fit or folds space.
        InputError: a clip that is not there, or a shape that the cameras do not see whole.
    """
    states: dict[str, State] = {}
    notes: list[str] = []
    maps: dict[str, Deformation] = {}
    if plan.analytic:
        for name, one in formulas(vertices, plan.bend_axis).items():
            moved = one.deformation(torch.from_numpy(vertices)).numpy()
            maps[name] = one.deformation
            description = describe_state(one, vertices, moved)
            states[name] = State(vertices=moved, angle_x=one.angle_x, description=description)
    for given, script in plan.edits:
        name = _free(_UNFIT.sub("_", given).lstrip(".-"), states)
        if name != given:
            notes.append(_renamed(f"edit {given!r}", name))
        bound = script.bound(torch.from_numpy(vertices))
        moved, maps[name] = bound.setting.points.numpy(), bound.deformation
        _in_sight(name, moved)
        notes += _small(name, vertices, moved)
        text = json.loads(script.to_json())
        _add(states, name, vertices, moved, {"type": "edit", "edit": text})
    pixels = {
        name: 2 * CAMERA_RADIUS * math.tan(0.5 * states[name].angle_x) / plan.resolution
        for name in maps
    }
    notes += long_triangles(vertices, model.faces, maps, pixels)
    chosen = list(plan.clips)
    if plan.every_clip:
        chosen += [(one.name, None) for one in model.clips if one.name not in dict(chosen)]
    poses: list[_Pose] = []
    for name, time in chosen:
        moved, found = _of_clip(model, name, time, vertices, (center, scale))
        displaced = float(np.linalg.norm(moved - vertices, axis=1).mean())
        if displaced < _STILL and time is None:
            notes.append(f"left out: the clip {name!r} does not move the shape")
            continue
        poses.append((name, found, moved))
    _add_clips(states, notes, vertices, poses)
    return states, notes


def formulas(vertices: FloatArray, bend_axis: Axis | None) -> dict[str, DeformedState]:
    """The analytic states of vertices (V, 3) by name, along z or x, whichever is longer."""
    extents = np.ptp(vertices, axis=0)
    axis: Literal["x", "z"] = "z" if extents[2] >= extents[0] else "x"
    return deformed_states(vertices, axis=axis, bend_axis=bend_axis)


def _add_clips(
    states: dict[str, State], notes: list[str], vertices: FloatArray, poses: Sequence[_Pose]
) -> None:
    """Add the states of clips under names of their own, and in sight of the cameras."""
    taken = [_slug(name) for name, _, _ in poses]
    travels = {name for name, _, moved in poses if _reach(moved) > _FARTHEST}
    for name, time, moved in poses:
        about: dict[str, Any] = {"type": "animation", "clip": name, "time": time}
        own = f"{name} {time:g}" if taken.count(_slug(name)) > 1 else name
        state = _free(_slug(own), states)
        if state != _slug(name):
            notes.append(_renamed(f"clip {name!r} at {time:g} s", state))
        if name in travels:
            away = _middle(moved) - _middle(vertices)
            about["removed_motion"] = away.tolist()
            moved = moved - away
            notes.append(
                f"the clip {name!r} leaves the cameras' sight: the motion of its middle is taken "
                f"out of the state {state!r} (removed_motion in deformation.json)"
            )
        _in_sight(state, moved)
        notes += _small(state, vertices, moved)
        _add(states, state, vertices, moved, about)


def _middle(vertices: FloatArray) -> FloatArray:
    return 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))


def _reach(vertices: FloatArray) -> float:
    return float(np.linalg.norm(vertices, axis=1).max())


def _vanished(vertices: FloatArray) -> bool:
    return float(np.ptp(vertices, axis=0).max()) < _GONE


def _small(name: str, before: FloatArray, after: FloatArray) -> list[str]:
    """What is to be said of a state that has shrunk, if it has."""
    share = float(np.ptp(after, axis=0).max() / np.ptp(before, axis=0).max())
    if share >= _SMALL:
        return []
    return [
        f"the state {name!r} has shrunk to {100 * share:.0f} % of the canonical extent, so that "
        "its pictures are nearly empty; take another time of the clip (--clips CLIP@T), or leave "
        "it out"
    ]


def _in_sight(name: str, after: FloatArray) -> None:
    if _vanished(after):
        raise InputError(
            f"benchmark: state {name!r}: expected a shape of some extent, got one that has "
            "vanished; take another time of the clip, or leave it out (--clips)"
        )
    if _reach(after) > _FARTHEST:
        raise InputError(
            f"benchmark: state {name!r}: expected a shape within {_FARTHEST:g} radii of the "
            f"canonical middle, which the cameras see from {CAMERA_RADIUS:g}, got one that reaches "
            f"{_reach(after):.2f}; deform it less, or take another time of the clip"
        )


def _free(name: str, states: Mapping[str, State]) -> str:
    """The name, with a number where it is in use, a prefix where it is the benchmark's own."""
    own = f"state_{name}" if _RESERVED.fullmatch(name) else name
    number, found = 1, own
    while found in states:
        number += 1
        found = f"{own}_{number}"
    return found


def _renamed(what: str, name: str) -> str:
    return f"the {what} is the state {name!r}"


def _of_clip(
    model: Model,
    name: str,
    time: float | None,
    vertices: FloatArray,
    frame: tuple[FloatArray, float],
) -> tuple[FloatArray, float]:
    """Vertices at a time of a clip, or at that of the greatest mean displacement; the time."""
    clip = model.clip(name)
    first, last = clip.span
    times = np.linspace(first, last, _LOOKS) if time is None else np.array([time])
    best: tuple[float, FloatArray, float] | None = None
    for one in times:
        moved = (model.at(clip, float(one)) - frame[0]) * frame[1]
        away = float(np.linalg.norm(moved - vertices, axis=1).mean())
        if _vanished(moved):
            away = -1.0  # Rather any other time.
        if best is None or away > best[0]:
            best = away, moved, float(one)
    assert best is not None
    return best[1], best[2]


def _add(
    states: dict[str, State],
    name: str,
    before: FloatArray,
    after: FloatArray,
    about: dict[str, Any],
) -> None:
    if not np.isfinite(after).all():
        raise InputError(f"benchmark: expected finite places in the state {name!r}, got NaN")
    grown = float(np.linalg.norm(after, axis=1).max() / np.linalg.norm(before, axis=1).max())
    angle = 2.0 * math.atan(max(1.0, grown) * math.tan(0.5 * ANGLE_X))
    away = np.linalg.norm(after - before, axis=1)
    states[name] = State(
        vertices=after,
        angle_x=angle,
        description={
            "name": name,
            **about,
            "camera_angle_x": angle,
            "vertex_displacement_mean": float(away.mean()),
            "vertex_displacement_max": float(away.max()),
            "bbox_min": after.min(axis=0).tolist(),
            "bbox_max": after.max(axis=0).tolist(),
        },
    )


def _slug(name: str) -> str:
    """A clip's name as that of a folder."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "clip"
