"""An object as splats at one or more moments: what a page without a server draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.asset.asset import Asset, Posed
from pcore.asset.gaussian_content import GaussianContent
from pcore.gaussians.carry import polar
from pcore.gaussians.covariance import covariances, quaternions
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
    """

    moments: tuple[Moment, ...]
    opacities: Tensor
    sh: Tensor
    footprint: Footprint
    background: tuple[float, float, float]

    def __len__(self) -> int:
        return len(self.opacities)


def record(asset: Asset, frames: Sequence[Posed]) -> Recording:
    """Keep an object as splats, as it is in some frames.

    Gaussians are kept as they are. Neural points become flat splats along their pieces of surface,
    of the one colour that pictures show of each (`splat_shapes`).

    Args:
        asset: the object.
        frames: from `asset.pose`, evenly in time.

    Raises:
        InputError: neural points whose surface nobody has estimated.
    """
    content = asset.content
    if not isinstance(content, GaussianContent):
        raise NotImplementedError
    rest = content.gaussians.detached().to("cpu")
    return Recording(
        moments=tuple(_moment(posed) for posed in frames),
        opacities=rest.opacities.float(),
        sh=rest.sh.float(),
        footprint=content.footprint,
        background=content.background,
    )


def _moment(posed: Posed) -> Moment:
    drawn = posed.content.drawn
    shape = drawn.gaussians.detached().to("cpu")
    count, gains = len(shape), drawn.gains
    spread = drawn.covariances
    spread = covariances(shape.quats, shape.scales) if spread is None else spread.detach().cpu()
    return Moment(
        means=shape.means.float(),
        covariances=spread.float(),
        turns=_turns(posed, count),
        gains=torch.ones(count) if gains is None else gains.detach().cpu().float().mean(dim=1),
    )


def _turns(posed: Posed, count: int) -> Tensor:
    if posed.local_maps is None:
        return torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1)
    from_rest = torch.linalg.inv(posed.local_maps.to_rest.detach().cpu().double())
    return quaternions(polar(from_rest)).float()
