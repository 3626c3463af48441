"""Colours of an object that follow photos of a deformed state; its shape stays."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from pcore.asset.asset import Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.neural_points import NeuralPoints
from pcore.asset.posing import EditLike
from pcore.data.scene import View
from pcore.fitting.fit_config import AppearanceConfig
from pcore.fitting.fit_photos import in_turns, photos_of
from pcore.fitting.fitter import picture_loss
from pcore.rivals.motion_stages import learn_looks

Progress = Callable[[int, int], None]


def fit_appearance(
    asset: Asset,
    edit: EditLike,
    views: Sequence[View],
    config: AppearanceConfig | None = None,
    *,
    progress: Progress | None = None,
) -> Asset:
    """Let the colours of an object follow photos of it in a pose, as in PAPR in Motion.

    Of Gaussians only what looks the same from everywhere is learned: a few photos say little about
    how colours change with the direction. Of neural points features and attention are, as they are
    seen in the pose. Under the edit it looks like the photos; the light that stands still is taken
    as it is, so that what it cannot explain ends up in the colours.

    Args:
        asset: the object.
        edit: its pose in the photos, as `fit_pose` finds it.
        views: the photos, with masks.
        config: None takes the defaults.
        progress: told (steps done, steps in all).

    Returns:
        The object with other colours, without a folder; `Asset.save` makes one.

    Raises:
        InputError: photos without masks.
        EditError: an edit that does not fit the object.
    """
    config = config or AppearanceConfig()
    content = asset.content
    if isinstance(content, NeuralPoints):
        return replace(asset, content=_looking(asset, content, edit, views, config, progress))
    assert isinstance(content, GaussianContent)
    return replace(asset, content=_colored(asset, content, edit, views, config, progress))


def _looking(
    asset: Asset,
    content: NeuralPoints,
    edit: EditLike,
    views: Sequence[View],
    config: AppearanceConfig,
    progress: Progress | None,
) -> NeuralPoints:
    """Neural points with features and attention that photos of their pose show."""
    papr = copy.deepcopy(content.papr)
    device = next(papr.parameters()).device
    photos_of(views, torch.device("cpu"))  # Refuses what shows no object.
    posed = asset.pose(edit).content.to(device)
    draws = torch.Generator().manual_seed(config.seed)
    numbers = replace(config.points, samples=min(config.points.samples, content.samples))
    total, done = numbers.steps, 0

    def tell() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    features = learn_looks(papr, posed, views, numbers, draws, tell)
    papr.requires_grad_(False)
    return replace(content, papr=papr, cloud=replace(content.cloud, features=features.cpu()))


def _colored(
    asset: Asset,
    content: GaussianContent,
    edit: EditLike,
    views: Sequence[View],
    config: AppearanceConfig,
    progress: Progress | None,
) -> GaussianContent:
    """Gaussians with colours that photos of their pose show."""
    device = content.gaussians.means.device
    photos = [one.at_most(config.pixels) for one in photos_of(views, device)]
    drawn = asset.pose(edit).content.drawn
    # The first coefficient does not turn with the object: what is learned posed holds at rest.
    rest = drawn.gaussians.sh.detach()
    first = rest[:, :1].clone().requires_grad_(True)
    optimizer = torch.optim.Adam([first], lr=config.rate)
    turns = in_turns(photos, config.views, config.seed)
    draw = torch.Generator().manual_seed(config.seed)
    for step in range(config.steps):
        optimizer.param_groups[0]["lr"] = config.rate * (1 - step / config.steps)
        colored = replace(drawn.gaussians, sh=torch.cat([first, rest[:, 1:]], dim=1))
        loss = picture_loss(
            replace(drawn, gaussians=colored),
            next(turns),
            torch.rand(3, generator=draw).to(rest),
            footprint=content.footprint,
            silhouettes=False,
        )
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if progress is not None:
            progress(step + 1, config.steps)
    gaussians = content.gaussians.detached()
    sh = torch.cat([first.detach(), gaussians.sh[:, 1:]], dim=1)
    return replace(content, gaussians=replace(gaussians, sh=sh))
