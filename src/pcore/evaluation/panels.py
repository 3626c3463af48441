"""Truth and methods side by side, colours and depth, from the pictures of one shot."""

from __future__ import annotations

from collections.abc import Sequence

from pcore.evaluation.figures import (
    Pixels,
    Range,
    color_pixels,
    depth_pixels,
    depth_range,
    sheet,
    truth_pixels,
)
from pcore.evaluation.runner import Taken

TRUTH = "truth"


def shared_range(taken: Taken, names: Sequence[str]) -> Range | None:
    """Depths of the colour scale: of the truth when it is known, else of all methods."""
    if taken.depth is not None:
        return depth_range([(taken.rgba[..., 3], taken.depth)])
    return depth_range([(taken.photos[n].alpha, taken.photos[n].depth) for n in names])


def renderings(taken: Taken, names: Sequence[str]) -> list[Pixels | None]:
    """Colours of the truth, then of every method."""
    return [truth_pixels(taken.rgba), *(color_pixels(taken.photos[n].rgb) for n in names)]


def depth_maps(taken: Taken, names: Sequence[str]) -> list[Pixels | None]:
    """Depth of the truth (None when it is not known), then of every method; one colour scale."""
    span = shared_range(taken, names)
    alpha, known = taken.rgba[..., 3], taken.depth
    first = None if known is None else depth_pixels(alpha, known, span)
    drawn = [depth_pixels(taken.photos[n].alpha, taken.photos[n].depth, span) for n in names]
    return [first, *drawn]


def comparison_sheet(taken: Taken, names: Sequence[str], *, cell: int = 220) -> Pixels:
    """One sheet: truth and methods in columns, colours above depth maps."""
    rows = [("rendering", renderings(taken, names)), ("depth", depth_maps(taken, names))]
    return sheet([TRUTH, *names], rows, cell=cell)
