"""A cage that is a box: few vertices in rows, to be dragged by hand."""

from __future__ import annotations

from itertools import product

import torch
from torch import Tensor

from pcore.deform.cage import Cage
from pcore.errors import InputError


def box_cage(lower: Tensor, upper: Tensor, cells: tuple[int, int, int]) -> Cage:
    """Make the surface of a box along the axes, divided evenly.

    Args:
        lower: (3,) world units.
        upper: (3,) world units, larger.
        cells: along x, y and z, at least 1 each; 2, 2, 2 make 26 vertices.

    Raises:
        InputError: a box without volume, or without cells.
    """
    if not bool((upper > lower).all()) or min(cells) < 1:
        raise InputError(
            f"cage: expected a box with volume and cells, got {lower.tolist()} to "
            f"{upper.tolist()} in {cells}"
        )
    grid = [
        place
        for place in product(*(range(count + 1) for count in cells))
        if any(at in (0, count) for at, count in zip(place, cells, strict=True))
    ]
    number = {place: row for row, place in enumerate(grid)}
    faces: list[tuple[int, int, int]] = []
    for axis in range(3):
        for side in (0, cells[axis]):
            faces += _side(number, cells, axis, side)
    share = torch.tensor(grid, dtype=torch.float64) / torch.tensor(cells, dtype=torch.float64)
    vertices = torch.lerp(lower.double().expand(len(grid), 3), upper.double(), share)
    return Cage(vertices=vertices, faces=torch.tensor(faces))


def _side(
    number: dict[tuple[int, ...], int], cells: tuple[int, int, int], axis: int, side: int
) -> list[tuple[int, int, int]]:
    """Triangles of one side, turned outward."""
    first, second = (axis + 1) % 3, (axis + 2) % 3

    def at(u: int, v: int) -> int:
        place = [0, 0, 0]
        place[axis], place[first], place[second] = side, u, v
        return number[tuple(place)]

    found: list[tuple[int, int, int]] = []
    for u, v in product(range(cells[first]), range(cells[second])):
        a, b, c, d = at(u, v), at(u + 1, v), at(u + 1, v + 1), at(u, v + 1)
        pair = [(a, b, c), (a, c, d)] if side else [(a, c, b), (a, d, c)]
        found += pair
    return found
