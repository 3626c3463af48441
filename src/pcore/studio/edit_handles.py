"""Handles of an edit of any kind: where they are, and the edit with one of them moved."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch

from pcore.editing.dragging import Mirror
from pcore.editing.state import EditState
from pcore.errors import EditError, PcoreError
from pcore.studio.cage_handles import KINDS, cage_handles, with_image, with_vertex, without_vertex
from pcore.studio.carrying import carried, carried_places, uncarried
from pcore.studio.formula_handles import CENTRED, MOVING, formula_handle, with_formula_handle
from pcore.studio.handle_edit import arriving, mirrored, moved_handle, placed
from pcore.studio.handle_pose import HandlePose

ONE = (*CENTRED, *MOVING)
"""Kinds of edit that have one handle, always."""
TURNING = ("anchors", *(kind for kind in ONE if kind != "scale"))
"""Kinds whose handles can be turned."""


def handles_of_edit(raw: dict[str, Any], state: EditState, index: int) -> list[HandlePose]:
    """Where the handles of an edit are now; none of kinds without them.

    Args:
        raw: the edit, without keyframes.
        state: the object.
        index: of the edit.
    """
    if raw["type"] == "anchors":
        return placed(raw, state, index)
    if raw["type"] in KINDS:
        own = cage_handles(raw)
        places = [one.place for one in own]
        seen = carried_places(torch.tensor(places, dtype=torch.float64), state, index).tolist()
        return [replace(one, place=(x, y, z)) for one, (x, y, z) in zip(own, seen, strict=True)]
    if raw["type"] not in ONE:
        return []
    return [carried(formula_handle(raw, arriving(state, index)), state, index)]


def handles_or_error(
    raw: dict[str, Any], state: EditState, index: int
) -> list[HandlePose] | PcoreError:
    """The same, or why there are none: a file of the edit is gone."""
    try:
        return handles_of_edit(raw, state, index)
    except PcoreError as error:
        return error


def with_handle(
    raw: dict[str, Any],
    number: int,
    before: HandlePose,
    after: HandlePose,
    state: EditState,
    index: int,
    mirror: tuple[Mirror, float] | None = None,
) -> dict[str, Any]:
    """Return an edit with one handle moved and turned.

    Args:
        raw: the edit, without keyframes.
        number: of the handle.
        before: where it is shown.
        after: where it is to be.
        state: the object.
        index: of the edit.
        mirror: across which another one does the same, and how far from the image of its place
            that one may be, world units.
    """
    if raw["type"] in ONE:
        own = formula_handle(raw, arriving(state, index))
        return with_formula_handle(raw, own, uncarried(own, before, after, state, index))
    if raw["type"] == "anchors":
        moved = moved_handle(raw, number, before, after)
        return moved if mirror is None else mirrored(moved, number, *mirror)
    own = cage_handles(raw)[number]
    moved = with_vertex(raw, number, own, uncarried(own, before, after, state, index))
    return moved if mirror is None else with_image(moved, number, *mirror)


def without_handle(raw: dict[str, Any], number: int) -> dict[str, Any] | None:
    """Return an edit without one of its handles; None where nothing is left of it.

    Raises:
        EditError: the edit has always one.
    """
    if raw["type"] in ONE:
        raise EditError("handle: this one belongs to the edit; delete the edit itself under Order")
    if raw["type"] in KINDS:
        return without_vertex(raw, number)
    if len(raw["handles"]) == 1:
        return None
    return {**raw, "handles": [one for k, one in enumerate(raw["handles"]) if k != number]}
