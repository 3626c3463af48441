"""Distances between point clouds: Chamfer, earth mover's, F-score (docs/concepts/metrics.md)."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from pcore.errors import InputError
from pcore.metrics.image_metrics import FloatArray

F_THRESHOLDS = (0.01, 0.02)
"""Distances under which points count as matched, on clouds normalised to [-1, 1]^3."""
_EMD_POINTS = 2048


@dataclass(frozen=True, kw_only=True)
class CloudScores:
    """How far a cloud is from the truth; lengths in units of the normalised truth.

    Attributes:
        chamfer: mean distance to the nearest point, both directions added.
        emd: mean distance under the best one-to-one matching of equally many points.
        f_01: F-score at 0.01.
        f_02: F-score at 0.02.
    """

    chamfer: float
    emd: float
    f_01: float
    f_02: float

    def row(self) -> dict[str, float]:
        """One flat row for a table."""
        return asdict(self)


def compare_clouds(
    predicted: FloatArray, truth: FloatArray, *, emd_points: int = _EMD_POINTS
) -> CloudScores:
    """Score a cloud against samples of the true surface.

    Both are normalised by the bounding box of the truth first (`to_unit_cube`).

    Args:
        predicted: (N, 3) world units.
        truth: (T, 3) samples of the true surface, world units.
        emd_points: points of each cloud that are matched for the earth mover's distance, drawn
            without replacement, always alike; fewer when a cloud has fewer.

    Raises:
        InputError: an empty cloud, another shape, NaN or infinity, or a truth without extent.
    """
    own, other = _cloud("predicted", predicted), _cloud("truth", truth)
    center, half = unit_cube(other)
    own, other = (own - center) / half, (other - center) / half
    there, back = nearest_distances(own, other), nearest_distances(other, own)
    count = min(emd_points, len(own), len(other))
    generator = np.random.default_rng(0)
    first, second = (c[generator.choice(len(c), count, replace=False)] for c in (own, other))
    return CloudScores(
        chamfer=float(there.mean() + back.mean()),
        emd=earth_movers_distance(first, second),
        f_01=f_score(there, back, F_THRESHOLDS[0]),
        f_02=f_score(there, back, F_THRESHOLDS[1]),
    )


def unit_cube(points: FloatArray) -> tuple[FloatArray, float]:
    """Centre (3,) and half the longest side of the bounding box of points (N, 3).

    (x - centre) / half lies in [-1, 1]^3 and keeps the proportions.

    Raises:
        InputError: points that are all in one place.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.5 * float((high - low).max())
    if not half > 0:
        raise InputError("cloud metrics: expected points with an extent, got all in one place")
    return 0.5 * (low + high), half


def nearest_distances(points: FloatArray, others: FloatArray) -> FloatArray:
    """Distance (N,) from every point (N, 3) to the nearest of the others (T, 3)."""
    distance, _ = KDTree(others).query(points)
    return np.asarray(distance, dtype=np.float64)


def f_score(there: FloatArray, back: FloatArray, threshold: float) -> float:
    """Harmonic mean of precision and recall; 0 when both are 0.

    Args:
        there: (N,) distances of the predicted points from the truth: precision.
        back: (T,) distances of the true points from the prediction: recall.
        threshold: largest distance that counts as found.
    """
    precision, recall = float((there <= threshold).mean()), float((back <= threshold).mean())
    total = precision + recall
    return 2 * precision * recall / total if total else 0.0


def earth_movers_distance(first: FloatArray, second: FloatArray) -> float:
    """Mean distance under the cheapest one-to-one matching of two clouds (n, 3), exact.

    Raises:
        InputError: different numbers of points.
    """
    if len(first) != len(second):
        raise InputError(
            f"earth mover's distance: expected equally many points, got {len(first)} and "
            f"{len(second)}; draw the same number from both"
        )
    cost = np.asarray(cdist(first, second), dtype=np.float64)
    rows, columns = linear_sum_assignment(cost)
    return float(cost[rows, columns].mean())


def _cloud(name: str, points: FloatArray) -> FloatArray:
    cloud = np.asarray(points, dtype=np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3 or len(cloud) == 0:
        raise InputError(f"{name} cloud: expected points (N, 3), got shape {cloud.shape}")
    if not np.isfinite(cloud).all():
        raise InputError(f"{name} cloud: expected finite points, got NaN or infinity")
    return cloud
