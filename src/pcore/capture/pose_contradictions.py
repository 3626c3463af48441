"""Photos from nearly one place that show different things: their poses cannot all be right.

Structure from motion folds scenes with repeated prints or rooms: two halves are laid onto one
another, every point fits, and only the pictures tell. Poses around an object that a turntable
turned are those of its own world: the room behind it stands still in all pictures.
"""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from pcore.data.scene import View
from pcore.geometry.camera import Camera
from pcore.geometry.object_region import Region

_ANGLE, _APART = 6.0, 0.25
"""Poses are near that look less than so many degrees apart, from places that are apart by less than
that share of the cameras' distance from the object."""
_SIDE = 40
"""Longer side of the pictures that are compared, pixels."""
_ALIKE, _BELOW = 0.6, 0.15
"""Near poses agree when their pictures correlate by more than that, or by no more than so much less
than most neighbours in name order do. Measured: neighbours 0.65 to 1, in a folded room 0.42."""
_NEIGHBOUR = 2
"""Views are neighbours that are no farther apart in name order: one photo after another."""
_ELSEWHERE = (0.7, 0.85, 1.25, 1.6, 2.5, 10.0)
"""Distances, in those of the object, at which a floor, a wall or the object itself is looked for
before near poses are said to contradict one another."""
_LEAST = 0.3
"""Share of a picture that both must show."""
_FEW, _TURNED = 8, 20.0
"""Photos that tell whether a room stands still, and how far from their mean axis they look."""
_RIM = 0.15
"""Part of a picture at its borders, where the object is not."""
_BLACK = 0.02
"""Darker in all photos is no part of them, but a bar."""
_DETAIL, _STILL = 0.01, 0.5
"""Contrast at the borders, from one pixel to the next, of a room that can be told; and the share of
it that stays where it is. Measured: 0.02 to 0.27 around nine objects, 0.99 behind a turntable."""
_WHOLE = 0.99
_DARK = 0.01
"""Added to colours before their ratio is taken."""
_LUMINANCE = (0.299, 0.587, 0.114)


@dataclass(frozen=True, kw_only=True)
class _Thumbnail:
    """A small picture (3, h, w), which of its pixels show something (h, w), and its camera."""

    rgb: Tensor
    shown: Tensor
    camera: Camera


@dataclass(frozen=True, kw_only=True, eq=False)
class NearPair:
    """Two views from nearly one place.

    Attributes:
        first: number of a view.
        second: number of the other, larger.
        degrees: between their viewing axes.
        apart: distance of their places, in in distances of the cameras.
        alike: correlation of what both show, -1 to 1.
        stops: (3,) by how many exposure steps red, green and blue of the second are brighter.
    """

    first: int
    second: int
    degrees: float
    apart: float
    alike: float
    stops: Tensor


@dataclass(frozen=True, kw_only=True)
class Contradictions:
    """What near poses say about one another.

    Attributes:
        pairs: all near ones.
        usual: median correlation of near neighbours in name order; None where there are none.
        contradicting: near pairs that show different things, the worst first.
        still: whether the borders of all pictures show the same, wherever the cameras stand.
    """

    pairs: tuple[NearPair, ...]
    usual: float | None
    contradicting: tuple[NearPair, ...]
    still: bool


def find_contradictions(views: Sequence[View], region: Region) -> Contradictions:
    """Compare all views from nearly one place, as if what they show lay where the object is.

    Args:
        views: in the order that they were taken in, as their names say.
        region: of the object.
    """
    poses = torch.stack([view.camera.world_from_camera for view in views]).double()
    axes, places = -poses[:, :3, 2], poses[:, :3, 3]
    degrees = torch.rad2deg(torch.arccos((axes @ axes.T).clamp(-1, 1)))
    apart = torch.cdist(places, places) / (places - region.center).norm(dim=-1).median()
    near = ((degrees < _ANGLE) & (apart < _APART)).triu(diagonal=1)
    small = [_thumbnail(view) for view in views]
    pairs: list[NearPair] = []
    for first, second in near.nonzero().tolist():
        seen = _on_plane(small[first], small[second], region.center)
        if seen is not None:
            pairs.append(
                NearPair(
                    first=first,
                    second=second,
                    degrees=float(degrees[first, second]),
                    apart=float(apart[first, second]),
                    alike=_correlation(*seen),
                    stops=(seen[1].mean(dim=-1) + _DARK).log2()
                    - (seen[0].mean(dim=-1) + _DARK).log2(),
                )
            )
    neighbours = [pair.alike for pair in pairs if pair.second - pair.first <= _NEIGHBOUR]
    usual = statistics.median(neighbours) if neighbours else None
    least = _ALIKE if usual is None else min(_ALIKE, usual - _BELOW)
    odd = [p for p in pairs if p.alike < least and p.second - p.first > _NEIGHBOUR]
    odd = [p for p in odd if _anywhere(small[p.first], small[p.second], region.center) < least]
    odd.sort(key=lambda pair: pair.alike)
    return Contradictions(
        pairs=tuple(pairs), usual=usual, contradicting=tuple(odd), still=_stands(small)
    )


def _thumbnail(view: View) -> _Thumbnail:
    camera = view.camera
    scale = _SIDE / max(camera.width, camera.height)
    size = max(4, round(scale * camera.height)), max(4, round(scale * camera.width))
    planes = torch.cat(
        [
            view.rgb(torch.ones(3)).permute(2, 0, 1),
            view.image.shown().expand(1, camera.height, camera.width),
        ]
    )
    small = F.interpolate(planes[None], size, mode="area")[0]
    return _Thumbnail(rgb=small[:3], shown=small[3], camera=camera.resized(size[1], size[0]))


def _on_plane(first: _Thumbnail, second: _Thumbnail, place: Tensor) -> tuple[Tensor, Tensor] | None:
    """Colours (3, P) of both where they show a plane through a place, across the first's axis."""
    rays = first.camera.rays()
    ahead = -first.camera.world_from_camera[:3, 2]
    depth = float(first.camera.depth(place[None]))
    points = rays.origins + rays.directions * (depth / (rays.directions @ ahead))[..., None]
    column, row, _ = second.camera.project(points.reshape(-1, 3))
    height, width = second.shown.shape
    grid = torch.stack([2 * column / width - 1, 2 * row / height - 1], dim=-1)
    planes = torch.cat([second.rgb, second.shown[None]])[None]
    seen = F.grid_sample(planes, grid.reshape(1, *first.shown.shape, 2), align_corners=False)[0]
    both = (seen[3] > _WHOLE) & (first.shown > _WHOLE)
    return None if float(both.float().mean()) < _LEAST else (first.rgb[:, both], seen[:3, both])


def _stands(small: Sequence[_Thumbnail]) -> bool:
    """Whether the room stands still in the pictures of cameras that are said to go around."""
    shapes = Counter(one.shown.shape for one in small)
    shape, count = shapes.most_common(1)[0]
    alike = [one for one in small if one.shown.shape == shape]
    axes = torch.stack([one.camera.world_from_camera[:3, 2] for one in alike])
    middle = F.normalize(axes.mean(dim=0), dim=0)
    turned = torch.rad2deg(torch.arccos((axes @ middle).clamp(-1, 1))).median()
    if count < _FEW or float(turned) < _TURNED:
        return False
    width = max(2, round(_RIM * min(shape)))
    rim = torch.ones(shape[0], shape[1] - 1, dtype=torch.bool)
    rim[width:-width, width:-width] = False
    rim &= torch.stack([one.shown for one in alike]).amin(dim=0).diff(dim=1).abs() == 0
    light = torch.stack([torch.einsum("c,chw->hw", torch.tensor(_LUMINANCE), a.rgb) for a in alike])
    rim &= _beside_no_bar(light.amax(dim=0) < _BLACK)
    # Along rows alone: the edge of a table lies in one row of pictures that are taken level.
    detail = light.diff(dim=2)[:, rim]
    whole = float(detail.square().mean())
    return whole > _DETAIL**2 and float(detail.mean(dim=0).square().mean()) > _STILL * whole


def _beside_no_bar(black: Tensor) -> Tensor:
    """(H, W - 1) neighbours in a row, two pixels from what is black in all pictures (H, W).

    Bars of a film and what straightening leaves empty stay where they are, as a room does.
    """
    near = F.max_pool2d(black.double()[None], 5, stride=1, padding=2)[0] > 0
    return ~(near[:, 1:] | near[:, :-1])


def _anywhere(first: _Thumbnail, second: _Thumbnail, place: Tensor) -> float:
    """The best correlation of two pictures, as if what they show lay nearer or farther."""
    away = place - first.camera.center
    planes = (_on_plane(first, second, first.camera.center + far * away) for far in _ELSEWHERE)
    return max((_correlation(*seen) for seen in planes if seen is not None), default=-1.0)


def _correlation(first: Tensor, second: Tensor) -> float:
    """Of the luminance of colours (3, P)."""
    x, y = (torch.tensor(_LUMINANCE) @ one for one in (first, second))
    x, y = x - x.mean(), y - y.mean()
    return float((x * y).sum() / (x.norm() * y.norm()).clamp_min(1e-9))
