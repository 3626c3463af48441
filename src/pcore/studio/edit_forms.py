"""What a page shows of each kind of edit: sliders, choices, and the edit that it begins as."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from pcore.editing.regions import FALLOFF
from pcore.errors import EditError
from pcore.geometry.point_cloud import extent_of, size_of


@dataclass(frozen=True, kw_only=True)
class Slider:
    """A number of an edit.

    Attributes:
        path: of the number in the edit file, such as "angle_deg" or "translation/0".
        label: on the page.
        low: least value of the slider; edits from files may hold more.
        high: greatest value.
        step: between two values.
        rest: value where the edit gives none, which changes nothing.
        in_sizes: bounds and step are shares of the object's size.
    """

    path: str
    label: str
    low: float
    high: float
    step: float
    rest: float = 0.0
    in_sizes: bool = False

    def scaled(self, size: float) -> Slider:
        """Return the same with bounds in world units, for an object of a size."""
        if not self.in_sizes:
            return self
        # Two digits: they stand below the slider.
        low, high, step, rest = (
            float(f"{one * size:.2g}") for one in (self.low, self.high, self.step, self.rest)
        )
        return Slider(path=self.path, label=self.label, low=low, high=high, step=step, rest=rest)


_ANGLE = Slider(path="angle_deg", label="Angle", low=-180, high=180, step=1)
_FACTOR = Slider(path="factor", label="Factor", low=-0.95, high=2, step=0.05)
_TIMES = Slider(path="factor", label="Times", low=0.1, high=3, step=0.05, rest=1)
_AMOUNT = Slider(path="amount", label="Amount", low=0, high=1.5, step=0.05, rest=1)
_FROM = Slider(path="limits/0", label="From", low=0, high=0.95, step=0.05)
_TO = Slider(path="limits/1", label="To", low=0.05, high=1, step=0.05, rest=1)
_MOVE = tuple(
    Slider(path=f"translation/{k}", label=f"Move {name}", low=-1, high=1, step=0.01, in_sizes=True)
    for k, name in enumerate("xyz")
)
_REACH = Slider(path="reach", label="Reach", low=0.02, high=1, step=0.01, rest=0.25, in_sizes=True)

SLIDERS: Mapping[str, tuple[Slider, ...]] = {
    "twist": (_ANGLE, _FROM, _TO),
    "bend": (_ANGLE, _FROM, _TO),
    "taper": (_FACTOR, _FROM, _TO),
    "stretch": (_FACTOR, _FROM, _TO),
    "scale": (_TIMES,),
    "rigid": (_ANGLE, *_MOVE),
    "part": (_ANGLE, _TIMES, *_MOVE),
    "anchors": (_AMOUNT, _REACH),
    "cage": (_AMOUNT,),
    "mesh": (_AMOUNT,),
    "displacement": (_AMOUNT,),
}
"""By the type of the edit; the first is what "Key" keys."""
AXES = ("x", "y", "z")
CHOICES: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    **{kind: {"axis": AXES} for kind in ("twist", "bend", "taper", "rigid", "part")},
    "stretch": {"axis": AXES, "profile": ("blender", "axial", "volume")},
}
"""Texts of an edit that may be one of a few."""
NEW = ("twist", "bend", "taper", "stretch", "scale", "rigid", "part")
"""Kinds that the page makes by name; handles make "anchors", the others come from files."""
CAGES: Mapping[str, int] = {"cage": 3, "fine cage": 5}
"""What the page makes besides: boxes, of so many cells along their longest side."""
LABELS: Mapping[str, str] = {
    **{kind: kind.capitalize() for kind in (*SLIDERS, *CAGES)},
    "anchors": "Handles",
    "rigid": "Move and turn all",
    "part": "Move a part",
    "cage": "Cage",
}
"""What the page calls kinds of edits."""
SOFT = Slider(
    path="region/falloff",
    label="Soft edge",
    low=0,
    high=0.4,
    step=0.01,
    rest=FALLOFF,
    in_sizes=True,
)
"""Of an edit with a region."""


def new_edit(kind: str, points: Tensor, region: Mapping[str, Any] | None) -> dict[str, Any]:
    """An edit that changes nothing yet, as an object of an edit file.

    Args:
        kind: one of `NEW`.
        points: (N, 3) as they arrive at it, world units; it is made about their middle.
        region: where it acts; None is everywhere, for a part a ball in the middle.

    Raises:
        EditError: another kind.
    """
    if kind not in NEW:
        raise EditError(f"edit: expected one of {', '.join(NEW)}, got {kind!r}")
    low, high = extent_of(points)
    middle = [round(value, 6) for value in ((low + high) / 2).double().tolist()]
    edit: dict[str, Any] = {"type": kind}
    if "axis" in CHOICES.get(kind, {}):
        edit["axis"] = "z"
    for slider in SLIDERS[kind]:
        if slider.path in ("angle_deg", "factor"):
            edit[slider.path] = slider.rest
    if kind == "part" and region is None:
        nearest = points[(points - (low + high) / 2).norm(dim=1).argmin()]
        radius = 0.15 * size_of(points)
        region = {"shape": "geodesic", "center": nearest.double().tolist(), "radius": radius}
    if kind != "part":
        edit["origin"] = middle
    if kind == "rigid" or kind == "part":
        edit["translation"] = [0.0, 0.0, 0.0]
    return edit if region is None else {**edit, "region": dict(region)}


def value_at(raw: Mapping[str, Any], slider: Slider) -> float:
    """The number that an edit has for a slider."""
    value: Any = raw
    for name in slider.path.split("/"):
        if isinstance(value, Mapping):
            value = value.get(name)
        elif isinstance(value, (list, tuple)):
            value = value[int(name)]
        if value is None:
            return slider.rest
    return float(value)
