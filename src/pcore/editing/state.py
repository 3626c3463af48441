"""An object between two commands of a session, and how it comes to be from another one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from pcore.deform.base import Deformation
from pcore.editing.anchors import AnchorRig
from pcore.editing.binding import Bound, begin
from pcore.editing.edits import Edit
from pcore.editing.script import EditScript
from pcore.editing.stack import Stack
from pcore.errors import EditError, InputError

_HELD = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class EditState:
    """An object between two commands; it never changes.

    Attributes:
        script: the edits so far and what is frozen, at a time.
        points: (N, 3) where the points are, in the precision of the canonical ones.
        bound: the edits as they are bound to the points.
        time: of its keyframes.
    """

    script: EditScript
    points: Tensor
    bound: Bound
    time: float = 0.0

    @property
    def deformation(self) -> Deformation:
        """All edits so far as one map of space, from the canonical points."""
        return self.bound.deformation

    @property
    def folds(self) -> Tensor:
        """(M,) numbers of the points where space folds; only plain rays draw a state with some."""
        return self.bound.folded.nonzero().squeeze(-1)

    @property
    def frozen(self) -> Tensor:
        """(N,) bool, which points are held more than they follow."""
        hold, rest = self.bound.hold, self.bound.setting.rest
        if hold is None:
            return torch.zeros(len(self.points), dtype=torch.bool)
        return hold.weight(rest) > _HELD

    @property
    def rays(self) -> Literal["aware", "plain"]:
        """The rays that can draw it, for `Asset.pose`."""
        return "plain" if bool(self.bound.folded.any()) else "aware"


@dataclass(frozen=True, kw_only=True, eq=False)
class Begun:
    """What the edits of a session are bound to.

    Attributes:
        points: (N, 3) canonical, world units.
        rig: of these points with learned weights.
        time: of the keyframes.
    """

    points: Tensor
    rig: AnchorRig | None = None
    time: float = 0.0

    def bound(
        self, stack: Stack, since: EditState | None, *, check: bool, quick: bool = False
    ) -> EditState:
        """Bind edits; what begins as another state does is taken from there.

        Args:
            stack: the edits.
            since: the other state; None binds all.
            check: look for folds, and refuse them.
            quick: fit local maps that have no formula in one step.

        Raises:
            EditError: an edit is not valid at the time, does not fit the points, or folds space.
        """
        script = stack.at(self.time)
        bound = _begun(script, since) or self._rest(script)
        done = len(bound.steps)
        for number, edit in enumerate(script.edits[done:], start=done + 1):
            try:
                bound = bound.then(edit, check=check, quick=quick)
            except (EditError, InputError) as error:
                kind: Any = getattr(edit, "type", "edit")
                raise EditError(f"edit {number} ({kind}): {error}") from error
        # As every command does: in double precision, then in that of the cloud.
        points = bound.setting.points.to(self.points)
        return EditState(script=script, points=points, bound=bound, time=self.time)

    def _rest(self, script: EditScript) -> Bound:
        resting = self.points.to(device="cpu", dtype=torch.float64)
        try:
            return begin(resting, script.freeze, rig=self.rig)
        except (EditError, InputError) as error:
            raise EditError(f"freeze: {error}") from error


def _begun(script: EditScript, since: EditState | None) -> Bound | None:
    """The edits that a script begins with as another state has bound them; None: none at all."""
    if since is None or since.script.freeze != script.freeze:
        return None
    pairs = zip(script.edits, since.script.edits, strict=False)
    common = next((n for n, (new, old) in enumerate(pairs) if not _alike(new, old)), None)
    if common is None:
        common = min(len(script.edits), len(since.script.edits))
    bound = since.bound
    while len(bound.steps) > common and bound.before is not None:
        bound = bound.before
    return bound


def _alike(one: Edit, other: Edit) -> bool:
    """Whether two edits do the same; names do nothing."""
    if one is other:
        return True
    return type(one) is type(other) and one.model_copy(update={"name": other.name}) == other
