"""Settings, models and views for training in milliseconds; most on the scene of `tiny_scene`."""

from __future__ import annotations

import signal
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import pytest
import torch
from torch import Tensor

from pcore.contrib.learned_skinning import SkinningConfig
from pcore.data.images import composite
from pcore.deform.sampler import DeformationRanges
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import PointCloud
from pcore.model.papr import Papr
from pcore.training.config import (
    FinetuneConfig,
    PatchConfig,
    PretrainConfig,
    Rates,
    SkinningTrainConfig,
)
from pcore.training.events import Event
from pcore.training.schedule import Schedule
from pcore.training.trainable import Trainable, trainable
from pcore.training.trained import Trained
from tiny_scene import CONFIG

RATES = Rates(
    points=Schedule(base=2e-3),
    attention=Schedule(base=3e-3),
    features=Schedule(base=1e-2),
    influence=Schedule(base=1e-2),
    unet=Schedule(base=3e-3),
)
ZERO = Schedule(base=0.0)
SKINNING = SkinningTrainConfig(
    network=SkinningConfig(neighbours=4, frequencies=2, layers=2, width=16),
    anchors=12,
    rate=Schedule(base=2e-2),
)


def pretrain_config(**changes: Any) -> PretrainConfig:
    """Twelve steps of patches of 16 pixels, from 60 points of the hull."""
    settings: dict[str, Any] = {
        "model": CONFIG,
        "rates": RATES,
        "steps": 12,
        "patch": PatchConfig(side=16),
        "points": 60,
        "influence_start": 1.0,
        "validate_every": 6,
        "save_every": 5,
        "seed": 3,
    }
    return PretrainConfig(**{**settings, **changes})


def finetune_config(**changes: Any) -> FinetuneConfig:
    """Six steps of patches of 16 pixels."""
    settings: dict[str, Any] = {
        "rates": RATES,
        "steps": 6,
        "patch": PatchConfig(side=16),
        "validate_every": 3,
        "save_every": 2,
        "ranges": DeformationRanges(stretch=(1.0, 1.5), scale=(0.8, 1.25)),
    }
    return FinetuneConfig(**{**settings, **changes})


def box_cloud(count: int = 60, seed: int = 0) -> PointCloud:
    """Random points inside the box of `tiny_scene`."""
    generator = torch.Generator().manual_seed(seed)
    corner = torch.tensor([0.6, 0.45, 0.35])
    return PointCloud(
        positions=(2 * torch.rand(count, 3, generator=generator) - 1) * corner,
        features=torch.randn(count, CONFIG.feature_size, generator=generator),
        influence=1 + 5 * torch.rand(count, generator=generator),
    )


def box_model(count: int = 60) -> Trained:
    """Random networks and points inside the box."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(1)
        papr = Papr(CONFIG).requires_grad_(False).eval()
    return Trained(papr=papr, cloud=box_cloud(count), step=0)


def box_work(stage: str = "pretrain") -> Trainable:
    """The same, ready to train."""
    base = box_model()
    return trainable(stage, base.papr, base.cloud, seed=5)


def copied(weights: dict[str, Tensor]) -> dict[str, Tensor]:
    """A copy that does not change along with the training."""
    return {name: tensor.clone() for name, tensor in weights.items()}


def weights_of(model: Trained) -> dict[str, Tensor]:
    """All tensors of a model by name."""
    cloud = {name: getattr(model.cloud, name) for name in ("positions", "features", "influence")}
    return {**model.papr.state_dict(), **cloud}


def assert_same(first: dict[str, Tensor], second: dict[str, Tensor]) -> None:
    """Bitwise."""
    assert first.keys() == second.keys()
    for name, tensor in first.items():
        assert torch.equal(tensor, second[name]), name


class Heard(list[Event]):
    """A listener that remembers."""

    def __call__(self, event: Event) -> None:
        self.append(event)

    def of(self, kind: type[Event]) -> list[Any]:
        """Events of one kind, in order."""
        return [event for event in self if isinstance(event, kind)]


@dataclass(frozen=True)
class FakeView:
    """A view whose pixels are given."""

    camera: Camera
    pixels: Tensor
    has_alpha: bool = True

    def rgba(self) -> Tensor:
        return self.pixels.clone()

    def rgb(self, background: Tensor) -> Tensor:
        return composite(self.pixels, background)

    def alpha(self) -> Tensor:
        return self.pixels[..., 3].clone()

    def valid(self) -> Tensor | None:
        return None


def ctrl_c_at(monkeypatch: pytest.MonkeyPatch, module: ModuleType, step: int) -> None:
    """Press Ctrl-C while a training module draws its patch of that number, from 1."""
    original, count = module.draw_patch, [0]

    def draw(*args: object) -> object:
        count[0] += 1
        if count[0] == step:
            signal.raise_signal(signal.SIGINT)
        return original(*args)

    monkeypatch.setattr(module, "draw_patch", draw)
