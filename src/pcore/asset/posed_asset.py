"""An asset in a pose, and how its pictures are taken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypedDict

import torch
from torch import Tensor

from pcore.geometry.local_maps import LocalMaps


class How(TypedDict, total=False):
    """Options of `Asset.render`; see `Sampling`."""

    samples: int | None
    fast: bool
    detail: float | None
    cancel: Callable[[], bool] | None
    progress: Callable[[float], None] | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Posed:
    """An asset as an edit leaves it; made by `Asset.pose`, drawn by `Asset.render`.

    Attributes:
        points: (N, 3) where its points are, world units.
        local_maps: how space moved around them; None where plain rays do not need it.
        notes: what is odd about the edits and was not refused, a sentence each.
        content: what the kind of object is posed as.
    """

    points: Tensor = field(repr=False)
    local_maps: LocalMaps | None = field(repr=False)
    notes: tuple[str, ...] = ()
    content: Any = field(repr=False)

    @property
    def linear(self) -> Tensor | None:
        """(N, 3, 3) Jacobians at its points, float64; None where nothing remembers them."""
        maps = self.local_maps
        return None if maps is None else torch.linalg.inv(maps.to_rest.double())
