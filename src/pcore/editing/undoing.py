"""A session that can go back: which edits there are now, and which there were."""

from __future__ import annotations

from typing import Literal, Self

from torch import Tensor

from pcore.editing.anchors import AnchorRig
from pcore.editing.animation import Animation
from pcore.editing.history import History, Moment
from pcore.editing.script import EditScript
from pcore.editing.stack import Stack
from pcore.editing.state import Begun, EditState
from pcore.errors import EditError

_KEPT = 12
"""States before and after the present one that stay in memory; others are bound again."""


class Undoable:
    """The points of an object, the edits after every command, and a time of their keyframes."""

    def __init__(
        self,
        points: Tensor,
        script: EditScript | Animation | Stack | None = None,
        *,
        rig: AnchorRig | None = None,
    ) -> None:
        """Begin with canonical points (N, 3), world units, and with edits if given.

        Args:
            points: where the session begins.
            script: edits to begin with; those with keyframes keep them, at their first time.
            rig: of these points with learned weights, see `EditScript.bind`.

        Raises:
            EditError: the edits do not fit the points.
        """
        self._canonical, self._rig = points.detach().clone(), rig
        stack = script if isinstance(script, Stack) else Stack.of(script or EditScript(edits=()))
        self._history = History(moments=(Moment(stack=stack, label="begin"),))
        self._time = stack.animation.start if stack.animated else 0.0
        self._states: dict[int, EditState] = {}
        self._states[0] = self._bound(stack, None, said=f"{stack.source}: ")

    @classmethod
    def resumed(
        cls, points: Tensor, history: History, time: float, *, rig: AnchorRig | None = None
    ) -> Self:
        """Go on where another session of the same points (N, 3) was.

        Raises:
            EditError: the present edits do not fit the points.
        """
        session = cls(points, history.present.stack, rig=rig)
        session._history, session._time = history.at(history.now), time
        session._states = {}
        _ = session.state
        return session

    def __repr__(self) -> str:
        edits = len(self.stack.edits)
        return f"{type(self).__name__}({len(self._canonical)} points, {edits} edits)"

    @property
    def state(self) -> EditState:
        """The present state."""
        return self._state_of(self._history.present)

    @property
    def canonical(self) -> Tensor:
        """The points (N, 3) before any edit."""
        return self._canonical.clone()

    @property
    def rig(self) -> AnchorRig | None:
        """Of the points with learned weights; None where none were learned."""
        return self._rig

    @property
    def stack(self) -> Stack:
        """The present edits, with their keyframes."""
        return self._history.present.stack

    @property
    def history(self) -> History:
        """All commands that can be undone and redone."""
        return self._history

    @property
    def time(self) -> float:
        """Of the keyframes; see `at`."""
        return self._time

    @property
    def can_undo(self) -> bool:
        """Whether there is a command to take back."""
        return self._history.now > 0

    @property
    def can_redo(self) -> bool:
        """Whether a command was taken back that can be done again."""
        return self._history.now + 1 < len(self._history.moments)

    def at(self, time: float, *, frames: Literal["exact", "quick"] = "exact") -> EditState:
        """Go to a time of the keyframes; no command, and nothing is looked for or refused.

        Args:
            time: of the keyframes.
            frames: as `EditSession.preview`; a quick state is not kept, `state` is the exact one.

        Raises:
            EditError: an edit is not valid then, or does not fit the points.
        """
        now, self._time = self._time, time
        try:
            if frames == "quick" and self.stack.animated:
                return self._bound(self.stack, self._any_state, check=False, quick=True)
            return self.state
        except EditError:
            self._time = now
            raise

    def undo(self) -> EditState:
        """Go back to the state before the last command.

        Raises:
            EditError: nothing was done.
        """
        if not self.can_undo:
            raise EditError("undo: expected a command to take back, got none; nothing was done yet")
        return self._go(self._history.now - 1)

    def redo(self) -> EditState:
        """Do again what was undone last.

        Raises:
            EditError: nothing was undone, or something else was done since.
        """
        if not self.can_redo:
            raise EditError("redo: expected a command that was undone, got none")
        return self._go(self._history.now + 1)

    def _do(self, stack: Stack, label: str, merge: str | None = None) -> EditState:
        return self._keep(stack, self._bound(stack, self.state), label, merge)

    def _keep(self, stack: Stack, state: EditState, label: str, merge: str | None) -> EditState:
        self._history = self._history.then(stack, label, merge)
        self._states[self._history.present.number] = state
        self._forget()
        return state

    def _go(self, now: int) -> EditState:
        history = self._history.at(now)
        state = self._state_of(history.present)
        self._history = history
        self._forget()
        return state

    def _forget(self) -> None:
        """Let go of states that are far away in the history, or were replaced."""
        moments, now = self._history.moments, self._history.now
        near = {one.number for one in moments[max(0, now - _KEPT) : now + _KEPT + 1]}
        self._states = {number: one for number, one in self._states.items() if number in near}

    def _state_of(self, moment: Moment) -> EditState:
        known = self._states.get(moment.number)
        if known is not None and (known.time == self._time or not moment.stack.animated):
            return known
        state = self._bound(moment.stack, known or self._any_state, check=False)
        self._states[moment.number] = state
        return state

    @property
    def _any_state(self) -> EditState | None:
        """One to take over from what begins alike."""
        present = self._states.get(self._history.present.number)
        return present or next(iter(self._states.values()), None)

    def _bound(
        self,
        stack: Stack,
        since: EditState | None,
        *,
        check: bool = True,
        quick: bool = False,
        said: str = "",
    ) -> EditState:
        try:
            begun = Begun(points=self._canonical, rig=self._rig, time=self._time)
            return begun.bound(stack, since, check=check, quick=quick)
        except EditError as error:
            raise EditError(f"{said}{error}") from error
