"""What later edits of a stack do to a handle of an earlier one, there and back."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from pcore.deform.base import Identity
from pcore.editing.state import EditState
from pcore.gaussians.covariance import quaternions
from pcore.geometry.rotation import nearest_rotation, rotations
from pcore.studio.handle_edit import arriving
from pcore.studio.handle_pose import HandlePose, Quat, triple

_STEPS = 8
"""Of Newton's iteration for the place that is carried somewhere."""
_NEAR = 1e-9
"""Of the distance to go, with which it ends."""


def carried_places(places: Tensor, state: EditState, index: int) -> Tensor:
    """Where the edits after one bring places (..., 3) that it leaves; all in world units."""
    return _followed(places.double(), state, index)[0]


def carried(pose: HandlePose, state: EditState, index: int) -> HandlePose:
    """Where the edits after one bring a handle of it, and how they turn it."""
    if not _later(state, index):
        return pose
    place, linear = _followed(triple(pose.place), state, index)
    return _pose(pose, place, nearest_rotation(linear) @ _matrix(pose.turn))


def uncarried(
    before: HandlePose, seen: HandlePose, wanted: HandlePose, state: EditState, index: int
) -> HandlePose:
    """The handle that later edits bring to where it is wanted.

    Args:
        before: the handle where the edit has it.
        seen: where later edits bring that; where nothing differs from it, nothing changes.
        wanted: where they are to bring the answer.
        state: the object.
        index: of the edit.
    """
    if not _later(state, index):
        return wanted
    aim, start = triple(wanted.place), triple(before.place)
    place, away = start, float((aim - triple(seen.place)).norm())
    for _ in range(_STEPS if away > 0 else 0):
        there, linear = _followed(place, state, index)
        if float((aim - there).norm()) <= _NEAR * away:
            break
        place = place + torch.linalg.lstsq(linear, (aim - there).unsqueeze(1)).solution[:, 0]
    if not float((_followed(place, state, index)[0] - aim).norm()) <= away:
        place = start + aim - triple(seen.place)  # Later edits fold there: as if there were none.
    turned = _matrix(wanted.turn) @ _matrix(seen.turn).T
    turn = nearest_rotation(_followed(start, state, index)[1])
    if wanted.turn == seen.turn:
        return replace(_pose(before, place, _matrix(before.turn)), turn=before.turn)
    return _pose(wanted, place, turn.T @ turned @ turn @ _matrix(before.turn))


def _later(state: EditState, index: int) -> bool:
    return any(not isinstance(one, Identity) for one in state.bound.steps[index + 1 :])


def _followed(places: Tensor, state: EditState, index: int) -> tuple[Tensor, Tensor]:
    """Places (..., 3) after the later edits, and the Jacobians (..., 3, 3) of their map.

    What is frozen is known of points alone: a place takes the share of the nearest one.
    """
    linear = torch.eye(3, dtype=torch.float64).expand(*places.shape, 3)
    share = _free(places, state, index)
    for step in state.bound.steps[index + 1 :]:
        if isinstance(step, Identity):
            continue
        part = share[..., None, None]
        own = step.jacobian(places)
        linear = linear + part * (own @ linear - linear)
        places = places + share.unsqueeze(-1) * (step(places) - places)
    return places, linear


def _free(places: Tensor, state: EditState, index: int) -> Tensor:
    """(...,) how much of the later edits places take."""
    hold = state.bound.hold
    if hold is None:
        return torch.ones(places.shape[:-1], dtype=torch.float64)
    away = torch.cdist(places.reshape(-1, 3), arriving(state, index + 1).points)
    nearest = state.bound.setting.rest[away.argmin(dim=1)]
    return (1 - hold.weight(nearest)).reshape(places.shape[:-1])


def _matrix(turn: Quat) -> Tensor:
    return rotations(torch.tensor(turn, dtype=torch.float64))


def _pose(pose: HandlePose, place: Tensor, turn: Tensor) -> HandlePose:
    x, y, z = place.tolist()
    w, a, b, c = quaternions(turn).tolist()
    return replace(pose, place=(x, y, z), turn=(w, a, b, c))
