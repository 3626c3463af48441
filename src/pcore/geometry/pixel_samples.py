"""Where in a pixel its rays go: the middle, a regular grid, or drawn places.

A photo's pixel is the mean of the light on a square. One ray through the middle sees one place of
it, which shows at edges and wherever an edit puts more of an object into a pixel than photos did.
"""

from __future__ import annotations

import math
from numbers import Integral
from typing import Any

import torch
from torch import Tensor

from pcore.errors import InputError


def check_samples(what: str, samples: Any) -> int:
    """Return a number of rays per pixel that makes a square grid: 1, 4, 9, ...

    Raises:
        InputError: it does not.
    """
    whole = type(samples) is not bool and isinstance(samples, Integral)
    if not whole or samples < 1 or math.isqrt(samples) ** 2 != samples:
        raise InputError(
            f"{what}: expected rays per pixel that make a square grid (1, 4, 9, ...), got "
            f"{samples!r}"
        )
    return int(samples)


def grid_places(samples: int) -> Tensor:
    """Middles of the cells of a square grid over the pixel, (S, 2): column and row, 0 to 1.

    Raises:
        InputError: S is no square number.
    """
    side = math.isqrt(check_samples("pixel", samples))
    steps = (torch.arange(side, dtype=torch.float32) + 0.5) / side
    row, column = torch.meshgrid(steps, steps, indexing="ij")
    return torch.stack([column.flatten(), row.flatten()], dim=-1)


def drawn_places(height: int, width: int, samples: int, generator: torch.Generator) -> Tensor:
    """Random places in every pixel, (H, W, S, 2): column and row, 0 to 1.

    Of the S columns and the S rows of a pixel each holds one place (N-rooks sampling), so that few
    of them already cover it.
    """
    shape = (height, width, samples)
    cells = torch.arange(samples, dtype=torch.float32).expand(shape)
    # Sorting random numbers gives random orders.
    rows = torch.rand(shape, generator=generator).argsort(dim=-1)
    jitter = torch.rand(*shape, 2, generator=generator)
    return (torch.stack([cells, rows.to(cells)], dim=-1) + jitter) / samples
