"""An object as splats at one or more moments: what a page without a server draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.asset.asset import Asset, Posed
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.standing import standing_of
from pcore.gaussians.carry import polar
from pcore.gaussians.covariance import quaternions
from pcore.gaussians.render import Footprint


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """N splats as they are at one moment, float32 on the CPU.

    Attributes:
        means: (N, 3) world units.
        covariances: (N, 3, 3) world units squared.
        turns: (N, 4) unit quaternions w, x, y, z, how each was turned since the rest: what was seen
            of it along d is seen along the turned d.
        gains: (N,) factors on the colours, of a light that stood still.
    """

    means: Tensor
    covariances: Tensor
    turns: Tensor
    gains: Tensor


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """The moments of N splats, evenly in time, and what they share.

    Attributes:
        moments: at least one.
        opacities: (N,) 0 to 1.
        sh: (N, K, 3) colours at rest, as `pcore.gaussians.Gaussians` has them.
        footprint: how they meet pixels.
        background: behind them, RGB in [0, 1].
        body: (N,) bool, which are the object and not what stands around it.
        axes: (3, 3) columns in world axes: right, ahead and up for who looks at it.
    """

    moments: tuple[Moment, ...]
    opacities: Tensor
    sh: Tensor
    footprint: Footprint
    background: tuple[float, float, float]
    body: Tensor
    axes: Tensor

    def __len__(self) -> int:
        return len(self.opacities)


def record(asset: Asset, frames: Sequence[Posed]) -> Recording:
    """Keep an object as splats, as it is in some frames.

    Gaussians are kept as they are; neural points become flat splats of one colour each.

    Args:
        asset: the object.
        frames: from `asset.pose`, evenly in time.
    """
    rest, content = asset.splats_at_rest, asset.content
    gaussians = isinstance(content, GaussianContent)
    standing = standing_of(asset)
    return Recording(
        moments=tuple(_moment(asset, posed) for posed in frames),
        opacities=rest.gaussians.opacities,
        sh=rest.gaussians.sh,
        footprint=content.footprint if gaussians else Footprint(),
        background=content.background if gaussians else asset.provenance.background,
        body=standing.body(asset.points),
        axes=standing.axes,
    )


def _moment(asset: Asset, posed: Posed) -> Moment:
    count, maps = len(posed.points), posed.local_maps
    shown, gains = asset.splats(posed, torch.zeros(3)), asset.gains_of(posed)
    turns = torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1)
    if maps is not None:
        turns = quaternions(polar(torch.linalg.inv(maps.to_rest.detach().cpu().double()))).float()
    return Moment(
        means=torch.from_numpy(shown.centers),
        covariances=torch.from_numpy(shown.covariances),
        turns=turns,
        gains=torch.ones(count) if gains is None else gains.detach().cpu().float(),
    )
