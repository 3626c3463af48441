"""How large a demo is."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pcore.training.config import FinetuneConfig, PretrainConfig
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.presets import demo_finetune, demo_pretrain, gaussian_preset


@dataclass(frozen=True, kw_only=True)
class DemoSettings:
    """How large a demo is."""

    gaussians: GaussianConfig
    pretrain: PretrainConfig
    finetune: FinetuneConfig
    resolution: int = 100
    """Pixels along each side of the sample's images."""
    train_views: int = 60
    test_views: int = 10
    frames: int = 48
    """Pictures of each video."""
    shown: tuple[int, ...] = (2, 6)
    """Numbers of the test views in the report."""


def default_settings() -> DemoSettings:
    """Settings of `pcore demo`."""
    return DemoSettings(
        gaussians=replace(gaussian_preset("tiny"), steps=1400, validate_every=700, save_every=700),
        pretrain=demo_pretrain(),
        finetune=demo_finetune(),
    )
