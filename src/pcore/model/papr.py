"""PAPR's networks: attention from rays to points, and the renderer that colours features."""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor, nn

from pcore.model.attention import ProximityAttention
from pcore.model.papr_config import COLOR_CHANNELS, PaprConfig
from pcore.model.unet import Unet

_FIRST_PART = 0.1
"""Factor on the last layer of the renderer network where colours go around it."""


class Papr(nn.Module):
    """The networks of PAPR; the points are passed in, the algorithm is `pcore.render`."""

    def __init__(self, config: PaprConfig) -> None:
        super().__init__()
        self.config = config
        self.attention = ProximityAttention(config)
        self.unet = Unet(config.value.size, config.unet_channels)
        if config.point_colors:
            # What the network adds to the points' colours begins small.
            with torch.no_grad():
                for parameter in self.unet.outc.parameters():
                    parameter *= _FIRST_PART

    def forward(self, features: Tensor) -> Tensor:
        """Colours (..., H, W, 3) of feature maps (..., H, W, C), over no background."""
        planes = features.flatten(0, -4) if features.dim() > 3 else features.unsqueeze(0)
        colours: Tensor = self.unet(planes.permute(0, 3, 1, 2))
        colours = colours.permute(0, 2, 3, 1).reshape(*features.shape[:-1], 3)
        return colours + features[..., :COLOR_CHANNELS] if self.config.point_colors else colours


def constant(values: tuple[float, ...], like: Tensor) -> Tensor:
    """Numbers of a configuration as a tensor like another."""
    return _sent_once(values, like.dtype, like.device)


@lru_cache(maxsize=64)
def _sent_once(values: tuple[float, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """Numbers on a device; sending them there makes it wait, so it is done once."""
    return torch.tensor(values, dtype=dtype, device=device)
