"""What a stage may cost on held-out training views, and as much of its change as that allows.

Weights on the straight line between a model and what fine-tuning made of it are good models too
(Wortsman et al., "Robust fine-tuning of zero-shot models", CVPR 2022), because both lie in one
basin of the loss. So a change that costs too much need not be thrown away: part of it is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from torch import Tensor

from pcore.errors import InputError, TrainingError

_HALVINGS = 7
_FREE = "skinning."


@dataclass(frozen=True, kw_only=True)
class Budget:
    """How far each held-out training view may fall.

    Each, not their mean: a few held-out views tell little about the mean of other views, and where
    the mean just fitted, other cameras lost 1.7 times as much (ADR 46).

    Attributes:
        before: all weights before the stage, by name.
        psnr: PSNR of every held-out training view with them, dB.
        largest_loss: how far below that the result may lie, dB; 0 or more.
    """

    before: Mapping[str, Tensor]
    psnr: Sequence[float]
    largest_loss: float

    def __post_init__(self) -> None:
        if not self.largest_loss >= 0:
            raise InputError(
                f"fine-tuning: expected largest_loss of 0 dB or more, got {self.largest_loss}; "
                "None leaves the budget out"
            )

    def met_by(self, psnr: Sequence[float]) -> bool:
        """Whether no view of a result (dB) has lost more than is allowed; not for NaN."""
        pairs = zip(psnr, self.psnr, strict=True)
        return all(after >= before - self.largest_loss for after, before in pairs)


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of a change.

    Attributes:
        share: 0 is before, 1 is after.
        psnr: PSNR of every held-out training view with it, dB.
        weights: all weights by name.
    """

    share: float
    psnr: Sequence[float]
    weights: Mapping[str, Tensor]


def largest_part(
    budget: Budget,
    after: Mapping[str, Tensor],
    psnr: Sequence[float],
    score: Callable[[Mapping[str, Tensor]], Sequence[float]],
) -> Part:
    """Return all of a change where that meets the budget, else as much as bisection finds to.

    Args:
        budget: what it may cost, and the weights before.
        after: the weights after, by the same names.
        psnr: that of `after`, dB.
        score: PSNR (dB) of every held-out training view with given weights.

    Returns:
        A part that meets the budget, its share to a 128th.

    Raises:
        TrainingError: the ends are not of one shape.
    """
    if budget.met_by(psnr):
        return Part(share=1.0, psnr=psnr, weights=after)
    best = Part(share=0.0, psnr=budget.psnr, weights=interpolated(budget.before, after, 0.0))
    too_far = 1.0
    for _ in range(_HALVINGS):
        share = (best.share + too_far) / 2
        weights = interpolated(budget.before, after, share)
        found = score(weights)
        if budget.met_by(found):
            best = Part(share=share, psnr=found, weights=weights)
        else:
            too_far = share
    return best


def interpolated(
    before: Mapping[str, Tensor], after: Mapping[str, Tensor], share: float
) -> dict[str, Tensor]:
    """Return weights between `before` (share 0, exactly) and `after` (share 1, exactly), copied.

    A skinning is taken whole from `after`: canonical pictures do not depend on it.

    Raises:
        TrainingError: the ends are not of one shape, as after a change of the number of points.
    """
    shapes = [{name: tuple(one.shape) for name, one in end.items()} for end in (before, after)]
    if shapes[0] != shapes[1]:
        odd = sorted({name for name, _ in shapes[0].items() ^ shapes[1].items()})
        raise TrainingError(
            f"fine-tuning: expected weights of one shape before and after, {', '.join(odd[:3])} "
            "differ; nothing lies between them. Do not change the number of points in fine-tuning"
        )
    return {
        name: one.clone() if name.startswith(_FREE) else before[name].lerp(one, share)
        for name, one in after.items()
    }
