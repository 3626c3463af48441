"""All constants of the light: how it is estimated, and how it falls on posed points."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class RelightConfig:
    """Constants of the light; chosen on objects and deformations of our own (ADR 11, ADR 14).

    They are saved with a light, since an estimate is only right with those it was made with.
    """

    encoding: float = 2.2
    """Exponent between the brightness that a photo stores and light; that of sRGB, nearly."""
    closest: float = 0.2
    """No point gets nearer to a lamp than this share of the lamp's distance from the centre."""

    directions: int = 192
    """Lamps, evenly over the sphere."""
    distances: tuple[float, ...] = (0.0, 0.23, 0.35, 0.47, 0.62, 0.8, 1.0)
    """Shares of the largest nearness at which lamps' light is computed; between, it is mixed."""
    nearest: float = 2.8
    """No lamp is nearer to the centre than so many radii of the object."""
    smooth: float = 5e-5
    """Weight of differences, of the logarithm, between neighbouring directions."""
    alike: float = 1e-2
    """Weight of differences between the lamps' nearness, a share of the largest."""
    far: float = 1e-4
    """Weight of that share itself: a lamp is far away unless the photos say something else."""
    near_pairs: int = 64
    """Every point is compared with some of so many that are nearest to it,"""
    like_pairs: int = 600
    """and with some of so many of the likest hue;"""
    pairs: int = 8
    """with so many of each."""
    nearer: float = 3.0
    """How much near pairs count more: graded paint is like light to those of like hue."""
    hues: float = 0.12
    """Difference of hue beyond which pairs count less."""
    robust: float = 0.1
    """Stored brightness, as a ratio, beyond which a difference is more likely one of paint: such
    pairs pull less the more they differ (Cauchy)."""
    steps: int = 300
    """Steps of the descent."""
    rate: float = 0.04
    """Its learning rate."""
    most_points: int = 6000
    """Points that take part, at most."""
    least_known: int = 50
    """Points with a normal that it takes."""

    darkest: float = 1e-3
    """Light that every point has at least, as a share of the usual, so that ratios stay finite."""
    largest_gain: float = 2.5
    """No point becomes brighter or darker by more than this factor: beyond, an estimate is no help.
    """
    bounces: int = 3
    """How often what hides light is lit anew itself."""

    shadow_cell: float = 0.5
    """Side of the cells of a shadow map in spacings; a point covers nine of them."""
    shadow_depths: tuple[float, float, float] = (1.0, 3.5, 8.0)
    """Points of a surface lie in a shell, and do not hide what is less deep below it. In spacings:
    for points that face away from the light, which belong to another surface than what they hide;
    for those whose normal is not known; and for those that face the light."""
    shadow_finest: int = 1024
    """Cells along the longest side of a map at most, so that a stray point does not cost a lot."""


DEFAULT = RelightConfig()
