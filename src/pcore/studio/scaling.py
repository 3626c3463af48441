"""The number of an edit that pulling at a handle's knobs makes larger or smaller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pcore.editing.anchors_edit import AnchorsEdit

_LEAST, _MOST = 0.05, 20.0
"""Bounds of what one pull multiplies by."""


@dataclass(frozen=True, kw_only=True)
class Scaling:
    """A number of an edit, as `value` counted from `zero`, where nothing would be left of it.

    Attributes:
        path: of the number in the edit file.
        value: of it now.
        zero: 0, or -1 for factors whose 0 changes nothing.
    """

    path: str
    value: float
    zero: float = 0.0

    def times(self, share: float) -> float:
        """The number that makes it so many times as large."""
        share = min(max(share, _LEAST), _MOST)
        return (self.value - self.zero) * share + self.zero


def scaling_of(raw: Mapping[str, Any], size: float) -> Scaling | None:
    """What knobs scale: the factor, the reach of handles, or the ball where it acts; None: nothing.

    Args:
        raw: the edit, without keyframes.
        size: of the object, world units.
    """
    kind, region = raw["type"], raw.get("region") or {}
    if kind in ("scale", "part"):
        return Scaling(path="factor", value=float(raw.get("factor", 1.0)))
    if kind in ("taper", "stretch"):
        return Scaling(path="factor", value=float(raw["factor"]), zero=-1.0)
    if kind == "anchors":
        return Scaling(path="reach", value=AnchorsEdit.reach_of(raw.get("reach"), size))
    if region.get("shape") == "geodesic":
        return Scaling(path="region/radius", value=float(region["radius"]))
    return None
