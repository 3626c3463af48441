"""What was done in a session, command by command, and what it can go back to."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pcore.editing.stack import Stack

LONGEST = 1000
"""Moments that are kept; with more the first ones are forgotten, so that hours do not add up."""


@dataclass(frozen=True, kw_only=True)
class Moment:
    """A session after a command.

    Attributes:
        stack: the edits.
        label: the command, such as "do twist".
        number: of the moment; no other one of the session has it.
    """

    stack: Stack
    label: str
    number: int = 0


@dataclass(frozen=True, kw_only=True)
class History:
    """The moments of a session, of which one is now; it never changes.

    Attributes:
        moments: from the first to the last, those that were undone too.
        now: index of the present one.
        merge: key of the last command, with which the next one may become one; None: with none.
    """

    moments: tuple[Moment, ...]
    now: int = 0
    merge: str | None = None

    @property
    def present(self) -> Moment:
        """The present moment."""
        return self.moments[self.now]

    def base(self, merge: str | None) -> Moment:
        """The moment that a command with this key starts from: it replaces one of the same key."""
        merged = merge is not None and merge == self.merge and self.now > 0
        return self.moments[self.now - merged]

    def then(self, stack: Stack, label: str, merge: str | None) -> History:
        """Return the history after a command; what was undone before is forgotten."""
        merged = self.base(merge) is not self.present
        kept = self.moments[: self.now + 1 - merged]
        number = 1 + max(one.number for one in self.moments)
        made = Moment(stack=stack, label=label, number=number)
        moments = (*kept, made)[-LONGEST:]
        return History(moments=moments, now=len(moments) - 1, merge=merge)

    def at(self, now: int) -> History:
        """Return the same history at another moment; the next command merges with none."""
        return replace(self, now=now, merge=None)
