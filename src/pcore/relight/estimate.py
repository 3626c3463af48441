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

from pcore.errors import InputError
from pcore.geometry.neighbours import nearest
from pcore.geometry.surfels import Surfels, known_normals, spacing_of
from pcore.relight.lamps import Light, falling_of, sphere
from pcore.relight.relight_config import DEFAULT, RelightConfig
from pcore.relight.relighting import Relighting, hidden_share
from pcore.relight.shadows import Shadows, shadows_of
from pcore.render.surfel_fit import Observed

IntArray = NDArray[np.int64]


def fit_light(observed: Observed, positions: Tensor, config: RelightConfig = DEFAULT) -> Relighting:
    """Estimate the light of a scene and the brightness of its points.

    Args:
        observed: what photos say about the points (`pcore.render.surfel_fit.observe`).
        positions: (N, 3) the canonical points, world units.
        config: constants.

    Raises:
        InputError: too few points have a normal that views agree on.
    """
    positions = positions.detach().cpu().float()
    surfels = Surfels.at_rest(positions, observed.normals, observed.heights)
    directions = sphere(config.directions)
    shadows = shadows_of(positions, surfels.normals, directions, spacing_of(positions), config)
    light = fit_lamps(observed, positions, shadows, config)
    brightness = brightness_of(observed, positions, config)
    return Relighting.of(light, positions, surfels, brightness, config)


def brightness_of(observed: Observed, positions: Tensor, config: RelightConfig = DEFAULT) -> Tensor:
    """Linear brightness (N,) of points (N, 3); what no view saw has that of the nearest one seen.

    Args:
        observed: what photos say about the points.
        positions: of the points, world units.
        config: constants.
    """
    bright = observed.colors.clamp_min(0).pow(config.encoding).mean(dim=1)
    seen = observed.attention > 0
    if bool(seen.all()) or not bool(seen.any()):
        return bright
    bright[~seen] = bright[seen][nearest(positions[seen], positions[~seen], 1)[0][:, 0]]
    return bright


def fit_lamps(
    observed: Observed, positions: Tensor, shadows: Shadows, config: RelightConfig = DEFAULT
) -> Light:
    """Estimate the light from how bright points are: robust least squares over pairs of them.

    The light on a point is a sum over D directions: of the lamp there, or of the brightness of what
    hides it, which the photos show. Radiance and distance of the lamps are chosen so that the
    logarithm of brightness over light differs little between two points of a pair. Distances of
    the lamps are drawn towards their mean. Deterministic; seconds.

    Args:
        observed: what photos say about N points.
        positions: (N, 3) of the points, world units.
        shadows: what the points hide from one another, towards `sphere(config.directions)`.
        config: constants.

    Raises:
        InputError: too few points with a normal, or shadows of other points or directions.
    """
    known = _known(observed, shadows, config)
    # Points without a normal may be strays that no photo shows.
    shown = positions[known]
    center = (shown.amin(dim=0) + shown.amax(dim=0)) / 2
    largest = 1 / (config.nearest * float((shown - center).norm(dim=1).max()))
    random = np.random.default_rng(0)
    if len(known) > config.most_points:
        chosen = random.choice(len(known), config.most_points, replace=False)
        known = known[torch.from_numpy(np.sort(chosen))]
    sent = _Sent.of(observed, positions, shadows, known, (center, largest), config)
    pairs = _pairs(positions[known], observed.colors[known], random, config)
    trust = observed.attention[known].sqrt()
    radiance, nearness = _descend(sent, pairs, trust / trust.mean(), config)
    return Light(
        directions=sphere(config.directions),
        radiance=radiance,
        nearness=nearness * largest,
        center=center,
    )


def _known(observed: Observed, shadows: Shadows, config: RelightConfig) -> Tensor:
    """Indices (K,) of the points whose normal is known; InputError when there are too few."""
    known = known_normals(observed.normals).nonzero()[:, 0]
    if len(known) < config.least_known:
        raise InputError(
            f"light: expected at least {config.least_known} points with a normal that the training "
            f"views agree on, got {len(known)} of {len(observed.normals)}; train longer, or do "
            "without (--light baked)"
        )
    expected = len(observed.normals), config.directions
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
        config: constants.
    """

    lamps: Tensor
    bounced: Tensor
    brightness: Tensor
    unit: float
    config: RelightConfig

    @staticmethod
    def of(
        observed: Observed,
        positions: Tensor,
        shadows: Shadows,
        chosen: Tensor,
        reach: tuple[Tensor, float],
        config: RelightConfig,
    ) -> _Sent:
        """Compute it for the points of some indices (K,).

        Args:
            observed: what photos say about all points.
            positions: (N, 3) all of them.
            shadows: of all of them.
            chosen: which count.
            reach: centre of the light and the largest nearness.
            config: constants.
        """
        count = config.directions
        directions, bright = sphere(count), brightness_of(observed, positions, config)
        normals, open_ = observed.normals[chosen], shadows.open[chosen]
        offsets = positions[chosen] - reach[0]
        lamps = [
            open_ * falling_of(offsets, normals, directions, torch.full((count,), q), config)
            for q in (share * reach[1] for share in config.distances)
        ]
        mine = Shadows(open=open_, hider=shadows.hider[chosen])
        share = hidden_share(normals, directions, mine)
        return _Sent(
            lamps=torch.cat(lamps, dim=1),
            bounced=(share * bright[mine.hider]).sum(dim=1),
            brightness=bright[chosen],
            unit=max(float(bright[chosen].median()), 1e-4),
            config=config,
        )

    def paint(self, radiance: Tensor, nearness: Tensor) -> Tensor:
        """Log of what the points (K,) show by themselves, given the lamps (D,) and (D,)."""
        light = (
            self.lamps @ (_mixed(nearness, self.config.distances) * radiance).flatten()
            + self.bounced
        )
        least = self.config.darkest * self.unit
        return (self.brightness + least).log() - (light + least).log()


def _mixed(nearness: Tensor, distances: Sequence[float]) -> Tensor:
    """Weights (G, D) of the distances for shares (D,) of the largest nearness: linear between."""
    steps = torch.tensor(distances)
    below = (torch.searchsorted(steps, nearness.detach(), right=True) - 1).clamp(0, len(steps) - 2)
    part = (nearness - steps[below]) / (steps[below + 1] - steps[below])
    weights = torch.zeros(len(steps), len(nearness))
    weights = weights.scatter(0, below[None], (1 - part)[None])
    return weights.scatter_add(0, below[None] + 1, part[None])


def _descend(
    sent: _Sent, pairs: _Pairs, trust: Tensor, config: RelightConfig
) -> tuple[Tensor, Tensor]:
    """Radiance (D,) and nearness (D,), a share of the largest, that explain pairs best."""
    directions = sphere(config.directions)
    beside = (directions @ directions.T).topk(7, dim=1).indices[:, 1:]
    weights = pairs.weights * trust[pairs.first] * trust[pairs.second]
    weights = weights / weights.mean()
    log_radiance = torch.full((len(directions),), math.log(2 * sent.unit), requires_grad=True)
    logit = torch.full((len(directions),), -0.94, requires_grad=True)
    optimizer = torch.optim.Adam([log_radiance, logit], lr=config.rate)
    with torch.enable_grad():
        for _ in range(config.steps):
            radiance, nearness = log_radiance.exp(), logit.sigmoid()
            paint = sent.paint(radiance, nearness) / config.encoding
            off = (paint[pairs.first] - paint[pairs.second]) / config.robust
            loss = 0.5 * config.robust**2 * (weights * (1 + off.square()).log()).mean()
            loss = (
                loss
                + config.smooth * (log_radiance[:, None] - log_radiance[beside]).square().mean()
            )
            share = (radiance / radiance.sum()).detach()
            mean = (share * nearness).sum()
            loss = loss + config.alike * (share * (nearness - mean).square()).sum()
            loss = loss + config.far * (share * nearness.square()).sum()
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


def _pairs(
    positions: Tensor, colors: Tensor, random: np.random.Generator, config: RelightConfig
) -> _Pairs:
    """Pair every point with some near it and some of like hue; hues that differ count less."""
    hue = _hues(colors, config.encoding)
    chosen = [
        _drawn(positions.double().numpy(), config.near_pairs, config.pairs, random),
        _drawn(hue.numpy(), config.like_pairs, config.pairs, random),
    ]
    second = torch.from_numpy(np.concatenate(chosen, axis=1).ravel())
    first = torch.arange(len(hue)).repeat_interleave(len(second) // len(hue))
    apart = (hue[first] - hue[second]).square().sum(dim=1)
    counts = torch.tensor([config.nearer, 1.0]).repeat_interleave(config.pairs).repeat(len(hue))
    return _Pairs(first, second, (-apart / config.hues**2).exp().float() * counts)


def _hues(colors: Tensor, encoding: float) -> Tensor:
    """Hues (N, 2) of stored colours (N, 3): logarithms of linear shares, whatever the light."""
    linear = colors.double().clamp_min(0).pow(encoding) + 0.005
    shares = (linear / linear.sum(dim=1, keepdim=True)).log()
    third, root = math.cos(2 * math.pi / 3), math.sin(2 * math.pi / 3)
    return shares @ torch.tensor([[1.0, 0.0], [third, root], [third, -root]]).double()


def _drawn(
    values: NDArray[np.float64], among: int, count: int, random: np.random.Generator
) -> IntArray:
    """For every row of values (N, C) so many of the rows that are nearest to it."""
    among = min(among, len(values))
    # Away from zero: where many hues are that of white, 0 exactly, the tree splits at the next
    # number, which is flushed to 0 in our processes (`set_flush_denormal`), and recurses for ever.
    values = values - values.min(axis=0) + np.ptp(values)
    near = KDTree(values).query(values, k=among)[1]
    slots = random.integers(1, among, size=(len(values), count))
    return np.take_along_axis(near, slots, axis=1)
