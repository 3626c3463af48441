"""What a page shows beside the object, and what there is to choose from."""

from __future__ import annotations

from dataclasses import dataclass

from pcore.errors import EditError
from pcore.studio.edit_forms import AXES

OVERLAYS = ("none", "strain", "holes", "handles", "exposed", "frozen")
CLICKS = ("nothing", "handle", "pin")
GIZMOS = ("all", "move", "turn", "scale")
TOOLS = ("box", "brush", "lasso", "ball")
MOVING = {"splats": 0, "points": 0, "pictures, 100 pixels": 100, "pictures, 200 pixels": 200}
"""What is shown while things move, and the pixels along a side where it is an exact picture."""
MANY = 100_000
"""Points from which on a page begins with points: a splat takes 32 bytes per event, a point 15."""
_CHOICES = {
    **{"overlay": OVERLAYS, "click": CLICKS, "gizmo": GIZMOS, "tool": TOOLS, "moving": MOVING},
    **{"mirror": ("off", *AXES), "lock": ("off", *AXES)},
}


@dataclass(frozen=True, kw_only=True)
class Shown:
    """What the page shows beside the object; it never changes.

    Attributes:
        selected: number of the edit whose handles and sliders are shown; None is none.
        handle: number of its handle that has the gizmo; None is none.
        chosen: numbers of the points that are selected.
        overlay: what is marked, one of `OVERLAYS`.
        still: the light stands still, where the object has one.
        mirror: "off", or the axis across which handles move in pairs: "x", "y" or "z".
        compare: share of the picture, from the left, that shows the object before the edits.
        lock: "off", or the axis along which alone handles move: "x", "y" or "z".
        gizmo: what arrows and rings of the selected handle do, one of `GIZMOS`.
        click: what a click without a key puts: "nothing", "handle" or "pin".
        tool: what a drag with Shift selects with, one of `TOOLS`.
        moving: what is shown while things move, one of `MOVING`.
        rest: an exact picture takes the place of that when things rest.
        brush: radius of the brush, and of the ball of a click, in shares of the object's size.
    """

    selected: int | None = None
    handle: int | None = None
    chosen: frozenset[int] = frozenset()
    overlay: str = "none"
    still: bool = True
    mirror: str = "off"
    compare: float = 0.0
    lock: str = "off"
    gizmo: str = "all"
    click: str = "nothing"
    tool: str = "box"
    brush: float = 0.05
    moving: str = "splats"
    rest: bool = True

    def __post_init__(self) -> None:
        """Raise EditError where a value is none of those that there are."""
        for name, known in _CHOICES.items():
            if (value := getattr(self, name)) not in (*known,):
                raise EditError(f"{name}: expected one of {', '.join(known)}, got {value!r}")
        if not 0 <= self.compare <= 1:
            raise EditError(f"compare: expected a share, 0 to 1, got {self.compare!r}")

    @property
    def exact(self) -> int:
        """Pixels, along a square's side, of exact pictures while things move; 0: none."""
        return MOVING[self.moving]
