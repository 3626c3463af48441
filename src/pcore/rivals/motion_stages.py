"""The two stages of PAPR-in-Motion (Peng et al. 2024) on a PAPR of ours, with photos of the end.

Supervised: it learns from photos of the very state that other methods are asked to show.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor, nn

from pcore.data.scene import View
from pcore.errors import InputError
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.model.papr import Papr
from pcore.rivals.kept import read_tensors, write_tensors
from pcore.training.config import PatchConfig
from pcore.training.losses import photometric, training_image
from pcore.training.patches import draw_patch

_SMOOTH_EVERY = 100
_PHOTOS, _RIGID = 2.0, 5.0
_LATE = 0.05
"""Factor on the rate of the points in the second half, in which nothing is smoothed."""


@dataclass(frozen=True, kw_only=True)
class MotionConfig:
    """Numbers of both stages; rates and neighbours are those of their scene `lego`."""

    steps: int = 1000
    """Of each stage; theirs are 40,000."""
    point_rate: float = 3e-2
    """In the coordinates of the networks."""
    neighbours: int = 100
    attention_rate: float = 1e-4
    feature_rate: float = 5e-3
    side: int = 80
    """Of the patches, pixels."""
    samples: int = 1
    """Rays per pixel, drawn anew in every step; 1 is the one through its centre."""
    seed: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """What both stages learned of one state.

    Attributes:
        positions: (N, 3) after the first stage, world units.
        features: (N, F) after the second.
        attention: networks after the second, by name.
    """

    positions: Tensor
    features: Tensor
    attention: dict[str, Tensor]

    def stage(self, number: int, papr: Papr, cloud: PointCloud) -> tuple[Papr, PointCloud]:
        """Networks and points as they are after a stage."""
        moved = replace(cloud, positions=self.positions)
        if number == 1:
            return papr, moved
        tuned = copy.deepcopy(papr)
        tuned.attention.load_state_dict(self.attention)
        return tuned, replace(moved, features=self.features)


def fit_motion(
    papr: Papr, cloud: PointCloud, views: Sequence[View], config: MotionConfig
) -> Motion:
    """Learn where the points went, then how they look there.

    LPIPS, a hundredth of their photometric loss, is left out: its weights are not on every machine.

    Args:
        papr: trained on the start state; left as it is.
        cloud: its points.
        views: training photos of the end state.
        config: numbers.

    Raises:
        InputError: no photos, or fewer points than neighbours.
    """
    if not views or len(cloud) <= config.neighbours:
        raise InputError(
            f"PAPR-in-Motion: expected photos of the end state and more than {config.neighbours} "
            f"points, got {len(views)} and {len(cloud)}"
        )
    networks = copy.deepcopy(papr).requires_grad_(False)
    draws = torch.Generator().manual_seed(config.seed)
    positions = _first_stage(networks, cloud, views, config, draws)
    moved = replace(cloud, positions=positions)
    features = learn_looks(networks, PosedCloud.at_rest(moved), views, config, draws)
    found = {name: t.detach().clone() for name, t in networks.attention.state_dict().items()}
    return Motion(positions=positions, features=features, attention=found)


def _first_stage(
    papr: Papr,
    cloud: PointCloud,
    views: Sequence[View],
    config: MotionConfig,
    draws: torch.Generator,
) -> Tensor:
    """Positions (N, 3): photos, squared distances to neighbours kept, displacements smoothed."""
    rest = cloud.positions.detach()
    tree = KDTree(rest.numpy())
    found = np.asarray(tree.query(rest.numpy(), k=config.neighbours + 1)[1])
    beside = torch.from_numpy(found[:, 1:])
    scale = papr.config.coord_scale / papr.config.unit
    before = _squared(rest * scale, beside)
    positions = nn.Parameter(rest.clone())
    optimizer = torch.optim.Adam([positions], lr=config.point_rate / scale)
    for step in range(1, config.steps + 1):
        moved = replace(cloud, positions=positions)
        loss = _PHOTOS * _error(papr, PosedCloud.at_rest(moved), views, config, draws)
        loss = loss + _RIGID * (_squared(positions * scale, beside) - before).abs().mean()
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        if 2 * step < config.steps and step % _SMOOTH_EVERY == 0:
            with torch.no_grad():
                positions.copy_(rest + (positions - rest)[beside].mean(dim=1))
        if 2 * step == config.steps or 2 * step == config.steps + 1:
            optimizer.param_groups[0]["lr"] *= _LATE
    return positions.detach()


def learn_looks(
    papr: Papr,
    posed: PosedCloud,
    views: Sequence[View],
    config: MotionConfig,
    draws: torch.Generator,
    told: Callable[[], None] = lambda: None,
) -> Tensor:
    """Learn how points look where they are: the second stage.

    Args:
        papr: its attention is changed in place, nothing else.
        posed: the points, and how rays see them there.
        views: photos of that.
        config: numbers.
        draws: chooses patches.
        told: after every step.

    Returns:
        (N, F) features.
    """
    features = nn.Parameter(posed.cloud.features.detach().clone())
    learned = list(papr.attention.requires_grad_(True).parameters())
    groups = [
        {"params": learned, "lr": config.attention_rate},
        {"params": [features], "lr": config.feature_rate},
    ]
    optimizer = torch.optim.Adam(groups)
    for _ in range(config.steps):
        looking = replace(posed, cloud=replace(posed.cloud, features=features))
        loss = _error(papr, looking, views, config, draws)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        told()
    return features.detach()


def _error(
    papr: Papr,
    posed: PosedCloud,
    views: Sequence[View],
    config: MotionConfig,
    draws: torch.Generator,
) -> Tensor:
    """Photometric loss of a patch of one view."""
    black = papr.config.background == (0.0, 0.0, 0.0)
    patch = draw_patch(
        views,
        PatchConfig(side=config.side, samples=config.samples),
        "black" if black else "white",
        draws,
        posed.positions.device,
    )
    image = training_image(papr, posed, patch.rays, patch.background)
    found = photometric(image, patch, opacity_weight=0.0, lpips_weight=0.0, perceptual=None)
    return found.total


def _squared(positions: Tensor, beside: Tensor) -> Tensor:
    return (positions[beside] - positions[:, None]).square().sum(dim=-1)


def kept_motion(
    path: Path, papr: Papr, cloud: PointCloud, views: Sequence[View], config: MotionConfig
) -> Motion:
    """Read what was learned of a state, or learn and write it; see `fit_motion`."""
    known = read_tensors(path)
    if known is None:
        made = fit_motion(papr, cloud, views, config)
        networks = {f"attention.{name}": t for name, t in made.attention.items()}
        write_tensors(path, {"positions": made.positions, "features": made.features, **networks})
        return made
    networks = {
        name.removeprefix("attention."): t
        for name, t in known.items()
        if name.startswith("attention.")
    }
    return Motion(positions=known["positions"], features=known["features"], attention=networks)
