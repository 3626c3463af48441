"""The feature extractors of LPIPS, layer for layer as torchvision numbers them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

TrunkName = Literal["alex", "squeeze", "vgg"]


@dataclass(frozen=True, kw_only=True)
class Trunk:
    """One feature extractor of LPIPS and the files that hold its weights.

    Attributes:
        title: name for people.
        build: makes the layers; indices equal torchvision's `features.<index>`.
        taps: indices of the layers whose outputs are compared.
        channels: channels of every tap.
        smallest: smallest image side that survives all pooling.
        files: accepted file names of the trunk, torch hub's own last.
        heads: accepted file names of the linear heads.
    """

    title: str
    build: Callable[[], nn.Sequential]
    taps: tuple[int, ...]
    channels: tuple[int, ...]
    smallest: int
    files: tuple[str, ...]
    heads: tuple[str, ...]


class Fire(nn.Module):
    """SqueezeNet's block: a 1 x 1 squeeze, then 1 x 1 and 3 x 3 side by side."""

    def __init__(self, inputs: int, squeezed: int, expanded: int) -> None:
        super().__init__()
        self.squeeze = nn.Conv2d(inputs, squeezed, 1)
        self.expand1x1 = nn.Conv2d(squeezed, expanded, 1)
        self.expand3x3 = nn.Conv2d(squeezed, expanded, 3, padding=1)

    def forward(self, features: Tensor) -> Tensor:
        """(B, inputs, H, W) -> (B, 2 expanded, H, W)."""
        narrow = torch.relu(self.squeeze(features))
        return torch.relu(torch.cat([self.expand1x1(narrow), self.expand3x3(narrow)], dim=1))


def _alexnet() -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(3, 64, 11, stride=4, padding=2),
        nn.ReLU(),
        nn.MaxPool2d(3, 2),
        nn.Conv2d(64, 192, 5, padding=2),
        nn.ReLU(),
        nn.MaxPool2d(3, 2),
        nn.Conv2d(192, 384, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(384, 256, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(256, 256, 3, padding=1),
        nn.ReLU(),
    )


def _squeezenet() -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(3, 64, 3, stride=2),
        nn.ReLU(),
        nn.MaxPool2d(3, 2, ceil_mode=True),
        Fire(64, 16, 64),
        Fire(128, 16, 64),
        nn.MaxPool2d(3, 2, ceil_mode=True),
        Fire(128, 32, 128),
        Fire(256, 32, 128),
        nn.MaxPool2d(3, 2, ceil_mode=True),
        Fire(256, 48, 192),
        Fire(384, 48, 192),
        Fire(384, 64, 256),
        Fire(512, 64, 256),
    )


def _vgg16() -> nn.Sequential:
    layers: list[nn.Module] = []
    inputs = 3
    for block, (width, depth) in enumerate([(64, 2), (128, 2), (256, 3), (512, 3), (512, 3)]):
        if block > 0:
            layers.append(nn.MaxPool2d(2, 2))
        for _ in range(depth):
            layers += [nn.Conv2d(inputs, width, 3, padding=1), nn.ReLU()]
            inputs = width
    return nn.Sequential(*layers)


TRUNKS: Mapping[TrunkName, Trunk] = {
    "alex": Trunk(
        title="AlexNet",
        build=_alexnet,
        taps=(1, 4, 7, 9, 11),
        channels=(64, 192, 384, 256, 256),
        smallest=32,
        files=("alexnet_features_torchvision.pth", "alexnet-owt-7be5be79.pth"),
        heads=("lin_alex.pth",),
    ),
    "squeeze": Trunk(
        title="SqueezeNet-1.1",
        build=_squeezenet,
        taps=(1, 4, 7, 9, 10, 11, 12),
        channels=(64, 128, 256, 384, 384, 512, 512),
        smallest=32,
        files=("squeezenet1_1_features_torchvision.pth", "squeezenet1_1-b8a52dc0.pth"),
        heads=("lin_squeeze.pth",),
    ),
    "vgg": Trunk(
        title="VGG-16",
        build=_vgg16,
        taps=(3, 8, 15, 22, 29),
        channels=(64, 128, 256, 512, 512),
        smallest=16,
        files=("vgg16_features_torchvision.pth", "vgg16-397923af.pth"),
        heads=("lin_vgg.pth",),
    ),
}
