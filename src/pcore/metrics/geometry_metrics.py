"""Depth error, holes and spill of one picture against the true geometry.

Formulas and the reasons for the thresholds: `docs/concepts/metrics.md`.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from pcore.errors import InputError
from pcore.metrics.image_metrics import (
    Array,
    FloatArray,
    Mask,
    as_array,
    as_plane_or_image,
    require_same_size,
)

SOLID_ALPHA = 0.95
"""Ground-truth opacity above which a pixel certainly shows the object."""
EMPTY_ALPHA = 0.05
"""Ground-truth opacity below which a pixel certainly shows the background."""
COVERED_ALPHA = 0.5
"""Predicted opacity from which a pixel counts as covered."""
DEPTH_TOLERANCE = 0.05
"""Depth error, as a fraction of the object's size, beyond which a pixel counts as a hole."""


@dataclass(frozen=True, kw_only=True)
class TrueGeometry:
    """What the camera should see.

    Attributes:
        alpha: (H, W) true opacity in [0, 1].
        depth: (H, W) true camera z in world units; NaN or infinity where the true surface is
            not hit.
        object_size: diagonal of the bounding box of the mesh in its state, world units.
    """

    alpha: Array
    depth: Array
    object_size: float


@dataclass(frozen=True, kw_only=True)
class GeometryScores:
    """Geometry of one picture; None where the ground truth has no such pixel.

    Attributes:
        hole_rate: solid pixels that are see-through or off in depth, as a fraction.
        see_through_rate: the see-through part of it.
        depth_off_rate: the part of it that is covered at a wrong depth.
        depth_error: mean |depth - true depth| over solid pixels covered by both, world units.
        depth_error_relative: the same as a fraction of the object's size.
        spill: empty pixels that are covered, as a fraction of the empty pixels.
        spill_to_object: the same count as a fraction of the solid pixels, which does not depend
            on how much empty picture surrounds the object; may exceed 1.
        solid_pixels: number of solid pixels, the weight for means over pictures.
        empty_pixels: number of empty pixels.
    """

    hole_rate: float | None
    see_through_rate: float | None
    depth_off_rate: float | None
    depth_error: float | None
    depth_error_relative: float | None
    spill: float | None
    spill_to_object: float | None
    solid_pixels: int
    empty_pixels: int

    def row(self) -> dict[str, float | int | None]:
        """One flat row for a table."""
        return asdict(self)


def measure_geometry(
    predicted_alpha: Array, predicted_depth: Array, truth: TrueGeometry
) -> GeometryScores:
    """Compare opacity and depth of one picture with the truth.

    Args:
        predicted_alpha: (H, W) in [0, 1].
        predicted_depth: (H, W) camera z in world units; need not be finite where
            `predicted_alpha` is under 0.5.
        truth: the true geometry at the same resolution.

    Raises:
        InputError: wrong shapes, sizes that differ, NaN in an opacity, no finite depth at a
            covered pixel, an object without size.
    """
    _check_size(truth.object_size)
    alpha = as_array("predicted alpha", predicted_alpha, None)
    depth = as_plane_or_image("predicted depth", predicted_depth, None)
    true_alpha = as_array("true alpha", truth.alpha, None)
    true_depth = as_plane_or_image("true depth", truth.depth, None)
    require_same_size(
        predicted_alpha=alpha, predicted_depth=depth, true_alpha=true_alpha, true_depth=true_depth
    )
    covered = alpha >= COVERED_ALPHA
    _check_depth(depth, covered)
    solid, empty = true_alpha > SOLID_ALPHA, true_alpha < EMPTY_ALPHA
    # A solid pixel whose centre just misses the mesh has no true depth: only its opacity counts.
    both = solid & covered & np.isfinite(true_depth)
    error = np.abs(depth[both] - true_depth[both])
    off = int((error > DEPTH_TOLERANCE * truth.object_size).sum())
    see_through = int((solid & ~covered).sum())
    spilled, solid_count, empty_count = _count(empty & covered), _count(solid), _count(empty)
    mean_error = float(error.mean()) if error.size else None
    return GeometryScores(
        hole_rate=_ratio(see_through + off, solid_count),
        see_through_rate=_ratio(see_through, solid_count),
        depth_off_rate=_ratio(off, solid_count),
        depth_error=mean_error,
        depth_error_relative=None if mean_error is None else mean_error / truth.object_size,
        spill=_ratio(spilled, empty_count),
        spill_to_object=_ratio(spilled, solid_count),
        solid_pixels=solid_count,
        empty_pixels=empty_count,
    )


def _check_size(size: float) -> None:
    if not (math.isfinite(size) and size > 0):
        raise InputError(
            "geometry metrics: expected the object's size as a positive length in world units, "
            f"got {size}"
        )


def _check_depth(depth: FloatArray, covered: Mask) -> None:
    bad = _count(covered & ~np.isfinite(depth))
    if bad:
        raise InputError(
            f"predicted depth: expected finite numbers where the predicted alpha is at least "
            f"{COVERED_ALPHA}, got NaN or infinity at {bad} pixels; look at the rendering"
        )


def _count(mask: Mask) -> int:
    return int(mask.sum())


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None
