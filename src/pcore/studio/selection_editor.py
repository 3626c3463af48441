"""An object whose points are selected, frozen, and where edits act; `Editor` adds handles."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from pcore.editing.stack import raw_region
from pcore.errors import EditError
from pcore.studio.stack_editor import StackEditor

HOW = ("replace", "add", "subtract")


class SelectionEditor(StackEditor):
    """A `StackEditor` with selected points."""

    def choose(
        self, points: Tensor, *, how: str = "replace", since: frozenset[int] | None = None
    ) -> None:
        """Select points (N,) bool.

        Args:
            points: which.
            how: one of `HOW`.
            since: what was selected before; None is what is selected now.
        """
        found = frozenset(points.nonzero().flatten().tolist())
        chosen = self.shown.chosen if since is None else since
        new = {"replace": found, "add": chosen | found, "subtract": chosen - found}[how]
        self.shown = replace(self.shown, chosen=new)

    def invert(self) -> None:
        """Select what is not selected."""
        everything = frozenset(range(len(self.asset.points)))
        self.shown = replace(self.shown, chosen=everything - self.shown.chosen)

    def grow(self) -> None:
        """Select the neighbours of what is selected, too."""
        self.choose(self.selector.grow(self.mask))

    def shrink(self) -> None:
        """Take the rim of the selection away."""
        self.choose(self.selector.shrink(self.mask))

    @property
    def mask(self) -> Tensor:
        """(N,) bool, which points are selected."""
        mask = torch.zeros(len(self.asset.points), dtype=torch.bool)
        mask[sorted(self.shown.chosen)] = True
        return mask

    def freeze(self) -> None:
        """Hold the selected points, besides what is held already."""
        held = [raw_region(entry) for entry in self.session.stack.freeze]
        self.session.freeze(*held, self.region())
        self.shown = replace(self.shown, chosen=frozenset())

    def thaw(self) -> None:
        """Let everything go that is frozen."""
        if self.session.stack.freeze:
            self.session.freeze()

    def limit(self, index: int, points: Tensor | None = None) -> None:
        """Make an edit act on points (N,) bool alone; None is everywhere.

        Raises:
            EditError: no point is selected, or the edit does not go without a region.
        """
        raw = self._whole(index)
        if points is None:
            raw.pop("region", None)
        else:
            ids = points.nonzero().flatten().tolist()
            if not ids:
                raise EditError("selection: expected points, got none; draw one with Shift held")
            seam = (raw.get("region") or {}).get("falloff")
            raw["region"] = self._soft(
                points_region(ids) | ({} if seam is None else {"falloff": seam})
            )
        self.session.replace(index, raw)


def points_region(ids: list[int]) -> dict[str, Any]:
    """The region of an edit file that holds points."""
    return {"shape": "points", "ids": ids}
