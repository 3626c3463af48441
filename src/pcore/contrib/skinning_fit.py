"""Fit skinning weights to random deformations, without pictures and without a renderer.

The direct term alone: skinned points against where the analytic field takes them, the fields being
those of fine-tuning. Seconds instead of the minutes of fine-tuning, on one CPU core.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from pcore.contrib.learned_skinning import Prior, Skinning
from pcore.contrib.skinning_loss import position_loss
from pcore.deform.base import Deformation
from pcore.deform.sampler import DeformationRanges, sample_deformation
from pcore.deform.skinning import SkinningWeights, pose_of, skin
from pcore.errors import InputError, TrainingError
from pcore.validation import check_count


@dataclass(frozen=True, kw_only=True)
class SkinningFitConfig:
    """How skinning weights are fitted; the values were measured (docs/research/skinning.md)."""

    steps: int = 800
    """Random deformations, one per step."""
    batch: int = 2048
    """Points of the cloud per step."""
    rate: float = 2e-3
    """Learning rate of Adam; falls to zero along a cosine."""
    ranges: DeformationRanges = field(default_factory=DeformationRanges)
    """How far the random deformations go."""
    seed: int = 0
    """Of deformations and batches."""

    def __post_init__(self) -> None:
        check_count("skinning fit: steps", self.steps)
        check_count("skinning fit: batch", self.batch)
        if not self.rate > 0:
            raise InputError(f"skinning fit: expected a rate above 0, got {self.rate}")


Progress = Callable[[int, float], None]


def fit_skinning(
    skinning: Skinning,
    points: Tensor,
    config: SkinningFitConfig,
    *,
    progress: Progress | None = None,
) -> Skinning:
    """Fit a skinning network to random deformations of its cloud.

    Args:
        skinning: where to start; left as it is.
        points: (N, 3) the canonical cloud, world units.
        config: steps, batch, rate.
        progress: called with (steps done, loss of the last).

    Returns:
        The same anchors with a fitted network.

    Raises:
        TrainingError: the loss is no longer a number.
    """
    points = points.detach().cpu()
    fitted = replace(skinning, network=copy.deepcopy(skinning.network).train())
    prior = fitted.prior(points)
    generator = torch.Generator().manual_seed(config.seed)
    adam = torch.optim.Adam(fitted.network.parameters(), lr=config.rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, config.steps)
    for step in range(1, config.steps + 1):
        loss = _loss(fitted, points, prior, config, generator)
        value = float(loss.detach())
        if not math.isfinite(value):
            raise TrainingError(
                f"skinning fit: the loss became {value} at step {step}, expected a finite "
                "number; lower the rate"
            )
        adam.zero_grad()
        loss.backward()
        adam.step()
        schedule.step()
        if progress is not None:
            progress(step, value)
    return replace(fitted, network=fitted.network.eval())


def _loss(
    skinning: Skinning,
    points: Tensor,
    prior: Prior,
    config: SkinningFitConfig,
    generator: torch.Generator,
) -> Tensor:
    """Direct term of some points of the cloud under one random deformation."""
    lower, upper = points.amin(dim=0), points.amax(dim=0)
    rows = torch.randint(len(points), (config.batch,), generator=generator)
    deformation = sample_deformation(generator, lower, upper, points, config.ranges)
    chosen = points[rows]
    weights = skinning.weights(chosen, prior.rows(rows))
    moved = skin(chosen, weights, pose_of(deformation, skinning.anchors))
    return position_loss(moved.positions, chosen, deformation, float((upper - lower).norm()))


def skinning_error(
    points: Tensor, weights: SkinningWeights, anchors: Tensor, fields: Sequence[Deformation]
) -> float:
    """Mean distance of skinned points from where given fields take them, world units.

    Args:
        points: (N, 3) the cloud.
        weights: of these points.
        anchors: (M, 3).
        fields: deformations that the fit has not seen.
    """
    with torch.no_grad():
        errors = [
            (skin(points, weights, pose_of(one, anchors)).positions - one(points)).norm(dim=1)
            for one in fields
        ]
    return float(torch.cat(errors).mean())
