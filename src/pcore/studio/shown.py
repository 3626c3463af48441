"""What a page shows beside the object, and what there is to choose from."""

from __future__ import annotations

from dataclasses import dataclass

CLICKS = ("nothing", "handle", "pin")
GIZMOS = ("all", "move", "turn", "scale")
TOOLS = ("box", "brush", "lasso", "ball")
MOVING = {"splats": 0, "points": 0, "pictures, 100 pixels": 100, "pictures, 200 pixels": 200}
"""What is shown while things move, and the pixels along a side where it is an exact picture."""
MANY = 100_000
"""Points from which on a page begins with points: a splat takes 32 bytes per event, a point 15."""


@dataclass(frozen=True, kw_only=True)
class Shown:
    """What the page shows beside the object; it never changes.

    Attributes:
        selected: number of the edit whose handles and sliders are shown; None is none.
        handle: number of its handle that has the gizmo; None is none.
        chosen: numbers of the points that are selected.
        overlay: "none", "strain", "holes" or "handles".
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

    @property
    def exact(self) -> int:
        """Pixels, along a square's side, of exact pictures while things move; 0: none."""
        return MOVING[self.moving]
