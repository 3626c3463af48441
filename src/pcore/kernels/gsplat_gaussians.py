"""Gaussians on a GPU by gsplat (extra `gsplat`): what its signature and ours share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch import Tensor


def rasterization(
    *arguments: Tensor | int | None, **options: Any
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Draw by gsplat; see `gaussian_rasterization.rasterization`, which looks after it."""
    import gsplat  # pyright: ignore[reportMissingImports, reportMissingTypeStubs]

    draw: Callable[..., tuple[Tensor, Tensor, dict[str, Any]]] = gsplat.rasterization
    # Packed results list the visible Gaussians alone and would give means2d another shape.
    return draw(*arguments, **options, packed=False)
