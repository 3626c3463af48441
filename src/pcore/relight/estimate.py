"""Estimate the light of a scene from its training photos and a trained model.

A surface shows its own brightness times the light that falls on it. Two points of one paint differ
by the light alone, so the ratios of their brightnesses tell the light. Which points are of one
paint nobody says: pairs are compared that lie near one another or have like colours, and those that
differ for another reason pull no harder than the rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from pcore.data.scene import View
from pcore.errors import InputError
from pcore.geometry.neighbours import nearest
from pcore.geometry.point_cloud import PointCloud
from pcore.model.papr import Papr
from pcore.relight.lamps import ENCODING, Light, falling_of, known_normals, sphere
from pcore.relight.photos import Observed, Progress, observe
from pcore.relight.shading import Shading, hidden_share, spacing_of
from pcore.relight.shadows import Shadows, shadows_of

DIRECTIONS = 192
SMOOTH = 5e-5
"""Weight of differences, of the logarithm, between neighbouring directions."""
ALIKE = 1e-2
"""Weight of differences between the lamps' nearness, a share of the largest."""
FAR = 1e-4
"""Weight of that share itself: a lamp is far away unless the photos say something else. All three,
and what follows, chosen on objects and deformations of our own, rendered with other lights than the
benchmark's (ADR 11)."""
_NEAREST = 2.8
"""No lamp is nearer to the centre than so many radii of the object."""
_DISTANCES = (0.0, 0.23, 0.35, 0.47, 0.62, 0.8, 1.0)
"""Shares of the largest nearness at which the lamps' light is computed; between, it is mixed."""
_BESIDE, _LIKE, _PAIRS = 64, 600, 8
"""Every point is compared with 8 of the 64 nearest ones and 8 of the 600 of the likest hue."""
_NEARER = 3.0
"""How much near pairs count more: graded paint is like light to those of like hue (ADR 14)."""
_HUES = 0.12
_ROBUST = 0.1
"""Stored brightness, as a ratio, beyond which a difference is more likely one of paint: such pairs
pull less the more they differ (Cauchy)."""
_STEPS, _RATE = 300, 0.04
_MOST_POINTS = 6000
_LEAST_KNOWN = 50
_DARKEST = 1e-3

IntArray = NDArray[np.int64]


def fit_shading(
    papr: Papr, cloud: PointCloud, views: Sequence[View], *, progress: Progress | None = None
) -> Shading:
    """Estimate light, normals and brightness of the points of a run.

    Args:
        papr: a trained model.
        cloud: its canonical points.
        views: training views.
        progress: told (views seen, views in all).

    Raises:
        InputError: too few points have a normal that views agree on.
    """
    observed = observe(papr, cloud, views, progress=progress)
    return shading_from(observed, cloud.positions.detach().cpu().float())


def shading_from(observed: Observed, positions: Tensor) -> Shading:
    """Estimate the light from what photos say about points (N, 3), float32 on the CPU.

    Raises:
        InputError: too few points have a normal.
    """
    shadows = shadows_of(positions, observed.normals, sphere(DIRECTIONS), spacing_of(positions))
    return Shading(
        light=fit_light(observed, positions, shadows),
        normals=observed.normals,
        positions=positions,
        brightness=brightness_of(observed, positions),
        lift=observed.lift,
    )


def brightness_of(observed: Observed, positions: Tensor) -> Tensor:
    """Linear brightness (N,) of points (N, 3); what no view saw has that of the nearest one seen.

    Args:
        observed: what photos say about the points.
        positions: of the points, world units.
    """
    bright = observed.colors.clamp_min(0).pow(ENCODING).mean(dim=1)
    seen = observed.attention > 0
    if bool(seen.all()) or not bool(seen.any()):
        return bright
    bright[~seen] = bright[seen][nearest(positions[seen], positions[~seen], 1)[0][:, 0]]
    return bright


def fit_light(
    observed: Observed,
    positions: Tensor,
    shadows: Shadows,
    *,
    smooth: float = SMOOTH,
    alike: float = ALIKE,
    far: float = FAR,
) -> Light:
    """Estimate the light from how bright points are: robust least squares over pairs of them.

    The light on a point is a sum over D directions: of the lamp there, or of the brightness of what
    hides it, which the photos show. Radiance and distance of the lamps are chosen so that the
    logarithm of brightness over light differs little between two points of a pair. Distances of
    the lamps are drawn towards their mean. Deterministic; seconds.

    Args:
        observed: what photos say about N points.
        positions: (N, 3) of the points, world units.
        shadows: what the points hide from one another, towards `sphere(DIRECTIONS)`.
        smooth: weight of differences between neighbouring directions.
        alike: weight of differences between distances.
        far: weight of nearness.

    Raises:
        InputError: too few points with a normal, or shadows of other points or directions.
    """
    known = _known(observed, shadows)
    # Points without a normal may be strays that no photo shows.
    shown = positions[known]
    center = (shown.amin(dim=0) + shown.amax(dim=0)) / 2
    largest = 1 / (_NEAREST * float((shown - center).norm(dim=1).max()))
    random = np.random.default_rng(0)
    if len(known) > _MOST_POINTS:
        chosen = random.choice(len(known), _MOST_POINTS, replace=False)
        known = known[torch.from_numpy(np.sort(chosen))]
    sent = _Sent.of(observed, positions, shadows, known, (center, largest))
    pairs = _pairs(positions[known], observed.colors[known], random)
    trust = observed.attention[known].sqrt()
    radiance, nearness = _descend(sent, pairs, trust / trust.mean(), smooth, alike, far)
    return Light(
        directions=sphere(DIRECTIONS),
        radiance=radiance,
        nearness=nearness * largest,
        center=center,
    )


def _known(observed: Observed, shadows: Shadows) -> Tensor:
    """Indices (K,) of the points whose normal is known; InputError when there are too few."""
    known = known_normals(observed.normals).nonzero()[:, 0]
    if len(known) < _LEAST_KNOWN:
        raise InputError(
            f"light: expected at least {_LEAST_KNOWN} points with a normal that the training views "
            f"agree on, got {len(known)} of {len(observed.normals)}; train longer, or do without "
            "(--light baked)"
        )
    expected = len(observed.normals), DIRECTIONS
    if tuple(shadows.open.shape) != expected:
        raise InputError(f"light: expected shadows {expected}, got {tuple(shadows.open.shape)}")
    return known


@dataclass(frozen=True, kw_only=True)
class _Sent:
    """Light on K points.

    Attributes:
        lamps: (K, G * D) from lamps of radiance 1 at each of G distances.
        bounced: (K,) off other points.
        brightness: (K,) that the photos show.
        unit: a usual brightness.
    """

    lamps: Tensor
    bounced: Tensor
    brightness: Tensor
    unit: float

    @staticmethod
    def of(
        observed: Observed,
        positions: Tensor,
        shadows: Shadows,
        chosen: Tensor,
        reach: tuple[Tensor, float],
    ) -> _Sent:
        """Compute it for the points of some indices (K,).

        Args:
            observed: what photos say about all points.
            positions: (N, 3) all of them.
            shadows: of all of them.
            chosen: which count.
            reach: centre of the light and the largest nearness.
        """
        directions, bright = sphere(DIRECTIONS), brightness_of(observed, positions)
        normals, open_ = observed.normals[chosen], shadows.open[chosen]
        offsets = positions[chosen] - reach[0]
        lamps = [
            open_ * falling_of(offsets, normals, directions, torch.full((DIRECTIONS,), q))
            for q in (share * reach[1] for share in _DISTANCES)
        ]
        mine = Shadows(open=open_, hider=shadows.hider[chosen])
        share = hidden_share(normals, directions, mine)
        return _Sent(
            lamps=torch.cat(lamps, dim=1),
            bounced=(share * bright[mine.hider]).sum(dim=1),
            brightness=bright[chosen],
            unit=max(float(bright[chosen].median()), 1e-4),
        )

    def paint(self, radiance: Tensor, nearness: Tensor) -> Tensor:
        """Log of what the points (K,) show by themselves, given the lamps (D,) and (D,)."""
        light = self.lamps @ (_mixed(nearness) * radiance).flatten() + self.bounced
        least = _DARKEST * self.unit
        return (self.brightness + least).log() - (light + least).log()


def _mixed(nearness: Tensor) -> Tensor:
    """Weights (G, D) of the distances for shares (D,) of the largest nearness: linear between."""
    steps = torch.tensor(_DISTANCES)
    below = (torch.searchsorted(steps, nearness.detach(), right=True) - 1).clamp(0, len(steps) - 2)
    part = (nearness - steps[below]) / (steps[below + 1] - steps[below])
    weights = torch.zeros(len(steps), len(nearness))
    weights = weights.scatter(0, below[None], (1 - part)[None])
    return weights.scatter_add(0, below[None] + 1, part[None])


def _descend(
    sent: _Sent, pairs: _Pairs, trust: Tensor, smooth: float, alike: float, far: float
) -> tuple[Tensor, Tensor]:
    """Radiance (D,) and nearness (D,), a share of the largest, that explain pairs best."""
    directions = sphere(DIRECTIONS)
    beside = (directions @ directions.T).topk(7, dim=1).indices[:, 1:]
    weights = pairs.weights * trust[pairs.first] * trust[pairs.second]
    weights = weights / weights.mean()
    log_radiance = torch.full((DIRECTIONS,), math.log(2 * sent.unit), requires_grad=True)
    logit = torch.full((DIRECTIONS,), -0.94, requires_grad=True)
    optimizer = torch.optim.Adam([log_radiance, logit], lr=_RATE)
    with torch.enable_grad():
        for _ in range(_STEPS):
            radiance, nearness = log_radiance.exp(), logit.sigmoid()
            paint = sent.paint(radiance, nearness) / ENCODING
            off = (paint[pairs.first] - paint[pairs.second]) / _ROBUST
            loss = 0.5 * _ROBUST**2 * (weights * (1 + off.square()).log()).mean()
            loss = loss + smooth * (log_radiance[:, None] - log_radiance[beside]).square().mean()
            share = (radiance / radiance.sum()).detach()
            mean = (share * nearness).sum()
            loss = loss + alike * (share * (nearness - mean).square()).sum()
            loss = loss + far * (share * nearness.square()).sum()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    return log_radiance.detach().exp(), logit.detach().sigmoid()


@dataclass(frozen=True)
class _Pairs:
    """Points that may be of one paint: indices (M,), (M,), and how much a pair counts (M,)."""

    first: Tensor
    second: Tensor
    weights: Tensor


def _pairs(positions: Tensor, colors: Tensor, random: np.random.Generator) -> _Pairs:
    """Pair every point with some near it and some of like hue; hues that differ count less."""
    hue = _hues(colors)
    chosen = [
        _drawn(positions.double().numpy(), _BESIDE, random),
        _drawn(hue.numpy(), _LIKE, random),
    ]
    second = torch.from_numpy(np.concatenate(chosen, axis=1).ravel())
    first = torch.arange(len(hue)).repeat_interleave(len(second) // len(hue))
    apart = (hue[first] - hue[second]).square().sum(dim=1)
    counts = torch.tensor([_NEARER, 1.0]).repeat_interleave(_PAIRS).repeat(len(hue))
    return _Pairs(first, second, (-apart / _HUES**2).exp().float() * counts)


def _hues(colors: Tensor) -> Tensor:
    """Hues (N, 2) of stored colours (N, 3): logarithms of linear shares, whatever the light."""
    linear = colors.double().clamp_min(0).pow(ENCODING) + 0.005
    shares = (linear / linear.sum(dim=1, keepdim=True)).log()
    third, root = math.cos(2 * math.pi / 3), math.sin(2 * math.pi / 3)
    return shares @ torch.tensor([[1.0, 0.0], [third, root], [third, -root]]).double()


def _drawn(values: NDArray[np.float64], among: int, random: np.random.Generator) -> IntArray:
    """For every row of values (N, C) some of the rows (N, 8) that are nearest to it."""
    among = min(among, len(values))
    near = KDTree(values).query(values, k=among)[1]
    slots = random.integers(1, among, size=(len(values), _PAIRS))
    return np.take_along_axis(near, slots, axis=1)
