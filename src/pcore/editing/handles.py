"""What tells that an edit by anchors has too few handles or too few anchors for its motion."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.deform.skinning import AnchorPose, SkinnedDeformation
from pcore.deform.weighted import Weighted
from pcore.editing.anchors import AnchorRig
from pcore.editing.anchors_edit import AnchorsEdit
from pcore.editing.binding import Bound, begin
from pcore.editing.diagnosis import CALM, Legend, painted
from pcore.editing.script import EditScript
from pcore.errors import EditError

TORN = 0.02
"""Share of the object's size by which anchors may disagree about a point."""
FAR = 0.15
"""Share of the object's size from the nearest handle beyond which nobody shapes a point; below the
reach that edits have without one of their own, which is a quarter."""
SHAPED = 0.02
"""Share of the object's size that a point moves at least for its shape to be somebody's matter."""


_LOOSE, _TORN = (0.05, 0.55, 0.55), (0.55, 0.3, 0.1)
HANDLE_LEGEND: Legend = (
    ("neither", CALM),
    ("moves with no handle near", _LOOSE),
    ("anchors disagree", _TORN),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class HandleDiagnosis:
    """How well the handles of an edit say where every point goes.

    Attributes:
        disagreement: (N,) how far apart the anchors of a point put it, as a share of the object's
            size: sqrt(sum_k w_k |R_k p + t_k - p'|^2) / size with p' = sum_k w_k (R_k p + t_k).
        distance: (N,) path length from the strongest anchor of a point to the nearest handle, as a
            share of the size. A handle that stays where it is counts; an anchor that rests because
            it is out of reach does not: nobody put it there.
        way: (N,) how far the edit moves the point, as a share of the size.
    """

    disagreement: Tensor
    distance: Tensor
    way: Tensor

    @property
    def torn(self) -> Tensor:
        """(N,) bool; the anchors around disagree: more anchors are needed, or less motion."""
        return self.disagreement > TORN

    @property
    def loose(self) -> Tensor:
        """(N,) bool; moves though no handle is near: more handles are needed, or less reach."""
        return (self.way > SHAPED) & (self.distance > FAR)

    def numbers(self) -> dict[str, float]:
        """All of it as figures for a report."""
        return {
            "anchors_disagree": float(self.torn.double().mean()),
            "disagreement_99": float(torch.quantile(self.disagreement, 0.99)),
            "without_handle": float(self.loose.double().mean()),
        }


def handle_colors(found: Iterable[HandleDiagnosis], count: int) -> Tensor:
    """Colours (N, 3) uint8 of `count` points: teal moves with no handle near, brown is torn.

    Grey is neither; brown covers teal, and what holds of one edit holds of all.
    """
    colors = painted(CALM).repeat(count, 1)
    diagnoses = tuple(found)
    for paint, which in (
        (_LOOSE, [d.loose for d in diagnoses]),
        (_TORN, [d.torn for d in diagnoses]),
    ):
        for where in which:
            colors[where] = painted(paint)
    return colors


def handle_numbers(found: Iterable[HandleDiagnosis]) -> dict[str, float]:
    """Figures of several edits together: the largest of each; empty without any."""
    rows = [one.numbers() for one in found]
    return {name: max(row[name] for row in rows) for name in (rows[0] if rows else ())}


def diagnose_handles(rig: AnchorRig, pose: AnchorPose, handles: Iterable[int]) -> HandleDiagnosis:
    """Tell where anchors are too sparse and handles too far away for a pose.

    Args:
        rig: the cloud with its anchors.
        pose: where the anchors are.
        handles: anchors whose place is given, by a handle or by a motion that is known.

    Raises:
        EditError: there is none.
    """
    held = sorted({*handles})
    if not held:
        raise EditError("handles: expected at least one anchor with a handle, got none")
    points = rig.points.double()
    anchors, weights = rig.weights.anchors, rig.weights.values.detach().double()
    turned = (pose.rotations != torch.eye(3, dtype=pose.rotations.dtype)).flatten(1).any(dim=1)
    moves = turned | (pose.moved != pose.rest).any(dim=1)
    # About all others every anchor says that they stay, and most are of those.
    some = moves[anchors].any(dim=1).nonzero().squeeze(1)
    own, here, share = anchors[some], points[some], weights[some]
    away = here.unsqueeze(1) - pose.rest.double()[own]
    wishes = (pose.rotations.double()[own] @ away.unsqueeze(-1)).squeeze(-1)
    wishes = wishes + pose.moved.double()[own]
    meant = (share.unsqueeze(-1) * wishes).sum(dim=1, keepdim=True)
    spread, way = torch.zeros_like(points[:, 0]), torch.zeros_like(points[:, 0])
    spread[some] = (share * (wishes - meant).square().sum(dim=-1)).sum(dim=1).sqrt()
    way[some] = (meant.squeeze(1) - here).norm(dim=1)
    strongest = anchors.gather(1, weights.argmax(dim=1, keepdim=True)).squeeze(1)
    path = rig.graph.between[:, held].double().amin(dim=1)
    size = max(rig.size, torch.finfo(torch.float32).tiny)
    return HandleDiagnosis(
        disagreement=spread / size,
        distance=path[strongest] / size,
        way=way / size,
    )


def handles_of(
    script: EditScript, points: Tensor, rig: AnchorRig | None = None
) -> dict[int, HandleDiagnosis]:
    """Diagnose every edit by anchors of a script, before its region and frozen parts act.

    Args:
        script: the edits.
        points: (N, 3) the canonical cloud, world units.
        rig: see `EditScript.bind`.

    Returns:
        Number of the edit, from 1 -> its diagnosis; empty without edits by anchors.

    Raises:
        EditError: as `EditScript.bind`, which is to be called first for its messages.
    """
    resting = points.detach().to(device="cpu", dtype=torch.float64)
    bound = begin(resting, script.freeze, rig=rig, allow_folds=True)
    for edit in script.edits:
        bound = bound.then(edit)
    return handles_in(bound, script)


def handles_in(bound: Bound, script: EditScript) -> dict[int, HandleDiagnosis]:
    """Do the same for a script that is bound already."""
    found = {} if bound.before is None else handles_in(bound.before, script)
    if bound.before is None:
        return found
    number, step = len(bound.steps), bound.steps[-1]
    edit = script.edits[number - 1]
    if isinstance(edit, AnchorsEdit) and edit.enabled:
        rig = edit.rig(bound.before.setting)
        step = step.inner if isinstance(step, Weighted) else step
        handles = edit.placed(rig)
        known = isinstance(step, SkinnedDeformation)
        pose = step.pose if known else edit.dragger(rig)[0].pose(handles)
        found[number] = diagnose_handles(rig, pose, handles)
    return found
