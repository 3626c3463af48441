"""Truth and methods side by side, colours and depth, from the pictures of one shot."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pcore.errors import InputError
from pcore.evaluation.figures import (
    Pixels,
    Range,
    color_pixels,
    depth_pixels,
    depth_range,
    sheet,
    truth_pixels,
)
from pcore.evaluation.health import Health, tinted_pixels
from pcore.evaluation.runner import Taken
from pcore.geometry.camera import Camera

TRUTH = "truth"
Window = tuple[slice, slice]
_MARGIN = 0.12
"""Room around an object on every side, as a fraction of its longer side."""


def shared_range(taken: Taken, names: Sequence[str]) -> Range | None:
    """Depths of the colour scale: of the truth when it is known, else of all methods."""
    if taken.depth is not None and taken.rgba is not None:
        return depth_range([(taken.rgba[..., 3], taken.depth)])
    return depth_range([(taken.photos[n].alpha, taken.photos[n].depth) for n in names])


def renderings(taken: Taken, names: Sequence[str]) -> list[Pixels | None]:
    """Colours of the truth (None when there is none), then of every method."""
    truth = None if taken.rgba is None else truth_pixels(taken.rgba)
    return [truth, *(color_pixels(taken.photos[n].rgb) for n in names)]


def depth_maps(taken: Taken, names: Sequence[str]) -> list[Pixels | None]:
    """Depth of the truth (None when it is not known), then of every method; one colour scale."""
    span = shared_range(taken, names)
    rgba, known = taken.rgba, taken.depth
    first = None if known is None or rgba is None else depth_pixels(rgba[..., 3], known, span)
    drawn = [depth_pixels(taken.photos[n].alpha, taken.photos[n].depth, span) for n in names]
    return [first, *drawn]


def strain_maps(taken: Taken, names: Sequence[str]) -> list[Pixels | None]:
    """Points of every method in the colours of their strain; None in the place of the truth."""
    return _of_points(taken, names, Health.strain_pixels)


def hole_maps(taken: Taken, names: Sequence[str]) -> list[Pixels | None]:
    """Points of every method in the colours of their tearing; None in the place of the truth."""
    return _of_points(taken, names, Health.hole_pixels)


def handle_maps(taken: Taken, names: Sequence[str]) -> list[Pixels | None]:
    """Points in the colours of too few handles; None without edits by anchors."""
    return _of_points(taken, names, Health.handle_pixels)


def _of_points(
    taken: Taken, names: Sequence[str], draw: Callable[[Health, Camera], Pixels | None]
) -> list[Pixels | None]:
    """Drawings of the points of methods that have some, after the truth, which has none."""
    known = [taken.health[name] for name in names]
    return [None, *(None if one is None else draw(one, taken.camera) for one in known)]


def unseen_maps(taken: Taken, names: Sequence[str]) -> list[Pixels | None]:
    """Renderings, yellow where they show what no training view saw; None where not known."""
    shown = [(taken.photos[name].rgb, taken.unseen[name]) for name in names]
    return [None, *(None if mask is None else tinted_pixels(rgb, mask) for rgb, mask in shown)]


def comparison_sheet(taken: Taken, names: Sequence[str]) -> Pixels:
    """One sheet: truth and methods in columns; colours, depth, and what may be going wrong.

    A state without a truth has no column for it.
    """
    rows = [
        ("rendering", renderings(taken, names)),
        ("depth", depth_maps(taken, names)),
        ("strain", strain_maps(taken, names)),
        ("holes", hole_maps(taken, names)),
        ("handles", handle_maps(taken, names)),
        ("unseen", unseen_maps(taken, names)),
    ]
    shown = [(title, row) for title, row in rows if any(picture is not None for picture in row)]
    if taken.rgba is None:
        return sheet(names, [(title, row[1:]) for title, row in shown])
    return sheet([TRUTH, *names], shown)


def object_window(taken: Taken) -> Window:
    """Rows and columns of a square around the true object, as large as the image at most.

    Raises:
        InputError: a state without a truth.
    """
    if taken.rgba is None:
        raise InputError(f"state {taken.state}: expected one with true images, got an edit file")
    solid = taken.rgba[..., 3].numpy() > 0
    size = solid.shape
    spans = [np.flatnonzero(solid.any(axis=axis)) for axis in (1, 0)]
    if not spans[0].size:
        return slice(0, size[0]), slice(0, size[1])
    longest = max(int(span[-1] - span[0]) + 1 for span in spans)
    side = min(round(longest * (1 + 2 * _MARGIN)), *size)
    starts = [
        min(max(0, (int(span[0] + span[-1]) + 1 - side) // 2), length - side)
        for span, length in zip(spans, size, strict=True)
    ]
    return slice(starts[0], starts[0] + side), slice(starts[1], starts[1] + side)
