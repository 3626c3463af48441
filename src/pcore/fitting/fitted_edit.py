"""Edits that say what a fit has found, and poses that edits say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from pcore.deform.skinning import AnchorPose, pose_of
from pcore.editing.anchors import AnchorRig
from pcore.editing.anchors_edit import AnchorsEdit, HandleEdit
from pcore.editing.animation import Animation
from pcore.editing.regions import Setting
from pcore.editing.script import EditScript
from pcore.fitting.anchor_motion import rotation_vectors
from pcore.fitting.fit_config import FitConfig

_STILL = 1e-6
"""A turn by less, radians, has no axis."""


def edit_of(pose: AnchorPose, config: FitConfig) -> EditScript:
    """Return the edit whose handles are all anchors of a pose; it means exactly that pose."""
    vectors = rotation_vectors(pose.rotations.double())
    handles = [
        HandleEdit(anchor=number, to=tuple(to), axis=axis, angle_deg=angle)
        for number, (to, (axis, angle)) in enumerate(
            zip(pose.moved.detach().double().tolist(), map(_axis_angle, vectors), strict=True)
        )
    ]
    edit = AnchorsEdit(handles=tuple(handles), count=len(handles), seed=config.seed)
    return EditScript(edits=(edit,))


def _axis_angle(vector: Tensor) -> tuple[tuple[float, float, float], float]:
    angle = float(vector.norm())
    if angle < _STILL:
        return (0.0, 0.0, 1.0), 0.0
    x, y, z = (vector / angle).tolist()
    return (x, y, z), math.degrees(angle)


def pose_of_edit(
    script: EditScript, points: Tensor, rig: AnchorRig, config: FitConfig
) -> AnchorPose:
    """Return the pose of a rig's anchors under an edit, to start from.

    Args:
        script: one edit by the same anchors is taken as it is; of anything else it is read where
            the anchors go and how they turn.
        points: (N, 3) canonical points, world units.
        rig: its anchors.
        config: their count and seed.

    Raises:
        EditError: the edit does not fit the points.
    """
    edits = script.edits
    if len(edits) == 1 and not script.freeze and isinstance(edits[0], AnchorsEdit):
        edit = edits[0]
        named = all(handle.anchor is not None for handle in edit.handles)
        same = edit.count == len(rig.indices) and edit.seed == config.seed
        if named and same and edit.region is None and not edit.freeze:
            dragger, handles = edit.dragger(rig)
            return dragger.pose(handles)
    bound = script.bind(points, allow_folds=True)
    return pose_of(bound, rig.graph.rest)


def anchor_rig(
    points: Tensor, learned: AnchorRig | None, config: FitConfig, most: int | None = None
) -> AnchorRig:
    """Return the anchors that the edit will ask for, no more than there are points.

    The learned ones are taken where they are the same.

    Args:
        points: (N, 3) canonical points, world units.
        learned: anchors of the run.
        config: their count and seed.
        most: so many of them at most.
    """
    points = points.detach().cpu().double()
    asked = AnchorsEdit(
        handles=(HandleEdit(anchor=0, to=(0.0, 0.0, 0.0)),),
        count=min(config.anchors, len(points), most or config.anchors),
        seed=config.seed,
    )
    return asked.rig(Setting(points=points, rest=points, rig=learned))


def keyframed(scripts: Sequence[EditScript], times: Sequence[float]) -> Animation:
    """Join edits of `edit_of` to one with keyframes, in which no anchor turns the long way round.

    Args:
        scripts: one for each time, of the same anchors.
        times: of each, increasing.
    """
    frames = [_turning_on(script) for script in scripts]
    edit = scripts[0].edits[0].model_dump(mode="json", exclude_none=True)
    handles: list[dict[str, Any]] = []
    for number, states in enumerate(zip(*frames, strict=True)):
        turns = _unwound([turn for _, turn in states])
        tracks = {
            "to": [to for to, _ in states],
            "axis": [axis for axis, _ in turns],
            "angle_deg": [angle for _, angle in turns],
        }
        keys = {
            name: {"keyframes": [[time, value] for time, value in zip(times, values, strict=True)]}
            for name, values in tracks.items()
        }
        handles.append({"anchor": number, **keys})
    entry = {key: value for key, value in edit.items() if key in ("type", "count", "seed")}
    return Animation({"version": 2, "edits": [{**entry, "handles": handles}]})


def _turning_on(script: EditScript) -> list[tuple[list[float], Tensor]]:
    edit = script.edits[0]
    assert isinstance(edit, AnchorsEdit)
    found: list[tuple[list[float], Tensor]] = []
    for handle in edit.handles:
        axis = torch.tensor(handle.axis, dtype=torch.float64)
        found.append((list(handle.to), math.radians(handle.angle_deg) * axis))
    return found


def _unwound(vectors: Sequence[Tensor]) -> list[tuple[list[float], float]]:
    """Axes and degrees of turns such that neighbours in time differ little in both."""
    turning = [v / v.norm() for v in vectors if float(v.norm()) >= _STILL]
    axis = turning[0] if turning else torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    last = 0.0
    found: list[tuple[list[float], float]] = []
    for vector in vectors:
        angle = float(vector.norm())
        if angle >= _STILL:
            own = vector / angle
            angle = angle if float(own @ axis) >= 0 else -angle
            axis = own if float(own @ axis) >= 0 else -own
        angle += 2 * math.pi * round((last - angle) / (2 * math.pi))
        last = angle
        found.append((axis.tolist(), math.degrees(angle)))
    return found
