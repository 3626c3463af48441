"""Which Gaussians come and go (Kerbl et al. 2023, "adaptive control")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.errors import TrainingError
from pcore.gaussians.render import GaussianPictures
from pcore.geometry.rotation import rotations
from pcore.training.events import Listener, PopulationReport
from pcore.training.gaussian_config import DensityConfig
from pcore.training.ranks import Ranks
from pcore.training.trainable_gaussians import TrainableGaussians

Rows = dict[str, Tensor]


@dataclass(frozen=True, kw_only=True)
class Change:
    """How a population changes.

    Attributes:
        keep: (N,) bool.
        new: rows to append by name.
    """

    keep: Tensor
    new: Rows


def changes(
    raw: Rows,
    gradients: Tensor,
    config: DensityConfig,
    distance: float,
    *,
    masked: bool,
    generator: torch.Generator,
) -> Change:
    """Decide on one change of the population.

    Args:
        raw: parameters (N, ...) as they are trained: `means`, `scales` (logarithms), `quats`,
            `opacities` (logits), and others, which are copied.
        gradients: (N,) mean length of the gradient of the centre on the screen.
        config: thresholds.
        distance: of the cameras, world units.
        masked: whether photos separate object from background.
        generator: of the draws.
    """
    largest = raw["scales"].exp().amax(dim=-1)
    gone = raw["opacities"].sigmoid() < config.faint
    if masked:
        gone = gone | (largest > config.huge * distance)
    room = config.limit - int((~gone).sum())
    wanted = (gradients > config.gradient) & ~gone
    if int(wanted.sum()) > room:
        # Those with the largest gradients; stable, so that equal ones are no matter of chance.
        order = torch.argsort(gradients.where(wanted, -1.0), descending=True, stable=True)
        wanted = torch.zeros_like(wanted)
        wanted[order[: max(0, room)]] = True
    large = largest > config.large * distance
    copied, parted = wanted & ~large, wanted & large
    parts = _parts(raw, parted, config.shrink, generator)
    new = {name: torch.cat([rows[copied], parts[name]]) for name, rows in raw.items()}
    return Change(keep=~gone & ~parted, new=new)


def _parts(raw: Rows, chosen: Tensor, shrink: float, generator: torch.Generator) -> Rows:
    """Two smaller ones, drawn from it, in the place of each."""
    twice = {name: rows[chosen].repeat(2, *[1] * (rows.ndim - 1)) for name, rows in raw.items()}
    scales = twice["scales"].exp()
    offsets = scales * torch.randn(scales.shape, generator=generator).to(scales)
    turned = (rotations(twice["quats"]) @ offsets.unsqueeze(-1)).squeeze(-1)
    twice["means"] = twice["means"] + turned
    twice["scales"] = (scales / shrink).log()
    return twice


@torch.no_grad()
def observe(
    work: TrainableGaussians, shown: Sequence[GaussianPictures], views: int, ranks: Ranks
) -> None:
    """Sum up how strongly the centres are pulled on the screen, per half a picture."""
    if not shown[0].means2d.retains_grad:
        return
    slopes, seen = torch.zeros_like(work.slopes), torch.zeros_like(work.seen)
    for one in shown:
        gradient = one.means2d.grad
        assert gradient is not None
        height, width = one.alpha.shape[1:]
        # Of the loss of this picture alone: the step's is the mean over all of them.
        half = views * gradient.new_tensor([width / 2, height / 2])
        lengths = (gradient * half).norm(dim=-1)
        slopes += lengths.sum(dim=0)
        seen += (lengths > 0).sum(dim=0)
    ranks.add([slopes, seen])
    work.slopes += slopes
    work.seen += seen


@torch.no_grad()
def change_population(
    work: TrainableGaussians, config: DensityConfig, masked: bool, tell: Listener
) -> None:
    """Let Gaussians come and go, and tell of it.

    Raises:
        TrainingError: none is left.
    """
    before = work.points
    change = changes(
        work.weights(),
        work.slopes / work.seen.clamp_min(1),
        config,
        work.distance,
        masked=masked,
        generator=work.generator,
    )
    kept, added = int(change.keep.sum()), len(change.new["means"])
    if kept + added == 0:
        raise TrainingError(
            f"training of Gaussians: none is left at step {work.step}, all have become "
            "transparent; check the poses and masks, or lower the learning rates"
        )
    work.replace(change.keep, change.new)
    tell(
        PopulationReport(
            stage=work.stage,
            step=work.step,
            pruned=before - kept,
            grown=added,
            points=work.points,
        )
    )
