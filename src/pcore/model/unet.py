"""The renderer: a small UNet that turns a feature map into colours."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

RECEPTIVE_MARGIN = 12
"""Pixels on each side that a colour depends on (10), rounded up to the UNet's alignment."""
ALIGNMENT = 4
"""Tiles that start at multiples of this see the same pooling grid as the whole image."""


class Unet(nn.Module):
    """Two poolings, two transposed convolutions, skips by concatenation, no output activation."""

    def __init__(self, size_in: int, channels: tuple[int, int, int]) -> None:
        super().__init__()
        full, half, quarter = channels
        self.inc = nn.Conv2d(size_in, full, 3, padding=1)
        self.down1 = nn.Conv2d(full, half, 3, padding=1)
        self.down2 = nn.Conv2d(half, quarter, 3, padding=1)
        self.up1 = nn.ConvTranspose2d(quarter, half, 2, stride=2)
        self.merge1 = nn.Conv2d(2 * half, half, 3, padding=1)
        self.up2 = nn.ConvTranspose2d(half, full, 2, stride=2)
        self.merge2 = nn.Conv2d(2 * full, full, 3, padding=1)
        self.outc = nn.Conv2d(full, 3, 1)

    def forward(self, features: Tensor) -> Tensor:
        """Colours (B, 3, H, W) of a feature map (B, C, H, W)."""
        full = F.relu_(self.inc(features))
        half = F.relu_(self.down1(F.max_pool2d(full, 2)))
        quarter = F.relu_(self.down2(F.max_pool2d(half, 2)))
        half = F.relu_(self.merge1(_join(half, self.up1(quarter))))
        full = F.relu_(self.merge2(_join(full, self.up2(half))))
        return self.outc(full)


def _join(skip: Tensor, upsampled: Tensor) -> Tensor:
    """Concatenate, after padding the upsampled map with zeros to the skip's size."""
    rows = skip.shape[-2] - upsampled.shape[-2]
    columns = skip.shape[-1] - upsampled.shape[-1]
    if rows or columns:
        padding = (columns // 2, columns - columns // 2, rows // 2, rows - rows // 2)
        upsampled = F.pad(upsampled, padding)
    return torch.cat([skip, upsampled], dim=1)
