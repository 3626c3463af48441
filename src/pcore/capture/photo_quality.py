"""How sharp and how bright photos are, and which ones stand out from the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from pcore.capture.pose_contradictions import NearPair
from pcore.data.scene import View

_SIDE = 480
"""Longer side of the pictures that are looked at, pixels: sharpness depends on it."""
_BLURRED = 0.45
"""Photos with less than that share of the sharpness of those taken around them are blurred."""
_AROUND = 5
"""Photos before and after one that it is compared with."""
_STOPS = 0.5
"""Photos brighter or darker than the middle by more exposure steps stand out."""
_DRIFT = 0.15
"""Spread (90 % of the photos) in exposure steps above which a colour per view is worth it."""
_ALIKE = 0.8
"""Only pairs of photos that show the same thing tell of exposure."""
_HOLD = 0.05
"""Pull of every photo towards no difference, against that of a pair."""
_FEW = 9
_FLAT = 1e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoQuality:
    """Sharpness and exposure of every photo.

    Attributes:
        sharpness: (N,) contrast of fine detail against that of the whole photo, of the object where
            there are masks.
        blurred: numbers of photos that are less sharp than those around them.
        stops: (N, 3) exposure steps (factors of two) of red, green and blue above the median photo,
            as near poses tell; 0 where no other is near.
        compared: (N,) bool, whether a near pose tells.
        odd_exposure: numbers of photos that are much brighter or darker than those beside them.
    """

    sharpness: Tensor
    blurred: tuple[int, ...]
    stops: Tensor
    compared: Tensor
    odd_exposure: tuple[int, ...]

    @property
    def drifts(self) -> bool:
        """Whether exposure or white balance differ enough for a colour transform per view."""
        edges = torch.quantile(self.stops, torch.tensor([0.05, 0.95]), dim=0)
        return bool((edges[1] - edges[0] > _DRIFT).any())


def photo_quality(views: Sequence[View], near: Sequence[NearPair]) -> PhotoQuality:
    """Measure photos; with masks only what shows the object counts for sharpness.

    Exposure is compared between photos from nearly one place alone: a view from behind shows other
    things, darker or brighter.

    Args:
        views: in the order that they were taken in; neighbours are compared.
        near: pairs of views from nearly one place.
    """
    sharpness = torch.tensor([_sharpness(view) for view in views])
    telling = [pair for pair in near if pair.alike > _ALIKE]
    stops = _balanced(len(views), telling)
    compared = torch.zeros(len(views), dtype=torch.bool)
    compared[[number for pair in telling for number in (pair.first, pair.second)]] = True
    bright = stops.mean(dim=1)
    return PhotoQuality(
        sharpness=sharpness,
        blurred=tuple(i for i in range(len(views)) if _is_blurred(sharpness, i)),
        stops=stops,
        compared=compared,
        odd_exposure=tuple((bright.abs() > _STOPS).nonzero().flatten().tolist()),
    )


def _balanced(count: int, near: Sequence[NearPair]) -> Tensor:
    """Steps (N, 3) whose differences are those of the pairs, by least squares."""
    system = _HOLD * torch.eye(count, dtype=torch.float64)
    right = torch.zeros(count, 3, dtype=torch.float64)
    for pair in near:
        for one, other, sign in ((pair.first, pair.second, -1), (pair.second, pair.first, 1)):
            system[one, one] += 1
            system[one, other] -= 1
            right[one] += sign * pair.stops.double()
    stops = torch.linalg.solve(system, right)
    return (stops - stops.median(dim=0).values).float()


def _sharpness(view: View) -> float:
    """Contrast of fine detail against that of all that a photo shows."""
    rgba = view.image.rgba()
    scale = min(1.0, _SIDE / max(rgba.shape[:2]))
    planes = rgba.permute(2, 0, 1)[None]
    if scale < 1:
        size = [max(3, round(scale * side)) for side in rgba.shape[:2]]
        planes = F.interpolate(planes, size, mode="area")
    rgb, alpha = planes[0, :3], planes[0, 3]
    inside = F.max_pool2d(-alpha[None, None], 3, stride=1)[0, 0] < -0.99
    if int(inside.sum()) < _FEW:
        return 0.0
    gray = rgb.mean(dim=0)
    around = gray[1:-1, 1:-1]
    laplacian = 4 * around - gray[:-2, 1:-1] - gray[2:, 1:-1] - gray[1:-1, :-2] - gray[1:-1, 2:]
    contrast = float(around[inside].std()) + _FLAT
    return float(laplacian[inside].square().mean().sqrt()) / contrast


def _is_blurred(sharpness: Tensor, index: int) -> bool:
    first = max(0, index - _AROUND)
    around = torch.cat([sharpness[first:index], sharpness[index + 1 : index + 1 + _AROUND]])
    return len(around) > 2 and float(sharpness[index]) < _BLURRED * float(around.median())
