"""Named settings: `paper` (the original), `fast` (one GPU), `tiny` (2 CPU cores, minutes)."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

from pcore.contrib.learned_skinning import SkinningConfig
from pcore.deform.sampler import DeformationRanges
from pcore.errors import InputError
from pcore.model.papr_config import MlpConfig, Octaves, PaprConfig
from pcore.training.config import (
    FinetuneConfig,
    GrowConfig,
    PatchConfig,
    PresetName,
    PretrainConfig,
    PruneConfig,
    Rates,
    SkinningTrainConfig,
)
from pcore.training.gaussian_config import (
    DensityConfig,
    GaussianConfig,
    GaussianFinetuneConfig,
    GaussianRates,
)
from pcore.training.schedule import Schedule

_PAPER_RATES = Rates(
    points=Schedule(base=2e-3),
    attention=Schedule(base=3e-4, warmup=10_000, part=0.5),
    features=Schedule(base=1e-3, warmup=10_000, part=0.5),
    influence=Schedule(base=1e-3, warmup=10_000, part=0.5),
    unet=Schedule(base=1e-4, warmup=10_000, part=0.5),
)
_SMALL_RATES = Rates(
    points=Schedule(base=2e-3, warmup=100, final=0.02),
    attention=Schedule(base=1e-3, warmup=100, final=0.02),
    features=Schedule(base=1e-2, warmup=100, final=0.02),
    influence=Schedule(base=1e-2, warmup=100, final=0.02),
    unet=Schedule(base=1e-3, warmup=100, final=0.02),
)


def _small_model(*, neighbours: int, across: int, width: int, unet: int) -> PaprConfig:
    return PaprConfig(
        neighbours=neighbours,
        octaves=Octaves(along=0, across=across, direction=1),
        feature_size=width // 2 + 8,
        key=MlpConfig(layers=3, width=width, size=width),
        query=MlpConfig(layers=3, width=width, size=width),
        value=MlpConfig(layers=4, width=width, size=32),
        unet_channels=(unet, 2 * unet, 4 * unet),
        point_colors=True,
        color_degree=1,
        cutoff=0.12,
        samples=4,
    )


PAPER = PretrainConfig(
    rates=_PAPER_RATES,
    points=3000,
    lpips_weight=0.01,
    prune=PruneConfig(),
    grow=GrowConfig(),
    mixed_precision=True,
)
"""The original's sizes and schedule; asks for LPIPS weights (VGG-16)."""

PAPER_LEGO = replace(
    PAPER,
    model=replace(
        PAPER.model,
        value=replace(PAPER.model.value, skip_after=5),
        negative_slope=0.2,
        background_score=3.0,
    ),
    rates=replace(_PAPER_RATES, points=Schedule(base=3e-3)),
    prune=PruneConfig(raised=0.2),
)
"""The original's configuration for its scene `lego`."""

FAST = PretrainConfig(
    model=_small_model(neighbours=12, across=6, width=128, unet=48),
    origin="reference",
    rates=_SMALL_RATES,
    steps=20_000,
    patch=PatchConfig(samples=2),
    points=20_000,
    influence_start=1.0,
    feature_spread=0.5,
    opacity_weight=0.1,
    front_weight=0.1,
    mixed_precision=True,
    validate_every=2000,
    save_every=2000,
)
"""For one GPU; asks for no weights."""

TINY = PretrainConfig(
    model=_small_model(neighbours=8, across=4, width=64, unet=24),
    origin="reference",
    rates=_SMALL_RATES,
    steps=3500,
    patch=PatchConfig(side=100, samples=2),
    points=6000,
    influence_start=1.0,
    feature_spread=0.5,
    opacity_weight=0.1,
    front_weight=0.1,
    validate_every=500,
    save_every=500,
)
"""For 2 CPU cores; asks for no weights."""

PretrainName = Literal[PresetName, "paper-lego"]
_PRESETS: dict[PretrainName, PretrainConfig] = {
    "tiny": TINY,
    "fast": FAST,
    "paper": PAPER,
    "paper-lego": PAPER_LEGO,
}


def preset(name: PretrainName) -> PretrainConfig:
    """Return the pre-training settings of that name.

    Raises:
        InputError: there is no such preset.
    """
    if name not in _PRESETS:
        raise InputError(f"preset: expected one of {', '.join(_PRESETS)}, got {name!r}")
    return _PRESETS[name]


_GAUSSIANS: dict[str, GaussianConfig] = {
    "tiny": GaussianConfig(held_out_until=0.5),
    "fast": GaussianConfig(
        steps=15_000,
        points=50_000,
        held_out_until=0.5,
        # The original's, which has twice as many steps.
        rates=GaussianRates(
            scales=Schedule(base=5e-3),
            quats=Schedule(base=1e-3),
            colors=Schedule(base=2.5e-3),
            harmonics=Schedule(base=1.25e-4),
        ),
        density=DensityConfig(every=100, first=500, gradient=2e-4, limit=300_000),
        validate_every=2500,
        save_every=2500,
    ),
}


def gaussian_preset(name: PretrainName) -> GaussianConfig:
    """Return the settings of Gaussians that go with a name: "tiny" (CPU) or "fast" (one GPU).

    Raises:
        InputError: Gaussians have no settings of that name.
    """
    if name not in _GAUSSIANS:
        raise InputError(
            f"preset of Gaussians: expected one of {', '.join(_GAUSSIANS)}, got {name!r}; "
            "the others are PAPR's (--model papr)"
        )
    return _GAUSSIANS[name]


def gaussian_finetune_preset(name: PresetName) -> GaussianFinetuneConfig:
    """Settings of P-CORE on Gaussians: "tiny" (CPU), or "fast" and "paper" (one GPU)."""
    if name == "tiny":
        return GaussianFinetuneConfig()
    return GaussianFinetuneConfig(steps=1500, rays=1024, validate_every=500, save_every=500)


def preset_of(config: PretrainConfig) -> PretrainName | None:
    """Name of the preset that has the architecture of these settings; None where none has."""
    return next((name for name, one in _PRESETS.items() if one.model == config.model), None)


def demo_pretrain() -> PretrainConfig:
    """Return `tiny`, shortened for the embedded sample."""
    return replace(
        TINY,
        steps=750,
        points=4000,
        front_weight=0.3,
        validate_every=250,
        save_every=250,
    )


def _scaled(rates: Rates, factor: float) -> Rates:
    """Return constant schedules of `factor` times the base rates that fade out by a cosine."""
    named = {
        name: Schedule(base=factor * one.base, warmup=20) for name, one in rates.named().items()
    }
    return Rates(**named)


_SMALL_FINETUNE = FinetuneConfig(
    steps=950,
    rates=_scaled(_SMALL_RATES, 0.5),
    patch=PatchConfig(side=100, samples=2),
    alternate=True,
    geometry_weight=0.1,
    texture_weight=0.5,
    texture_target="photo",
    origin_distance=0.1,
    keep_distance=True,
    opacity_weight=0.1,
    front_weight=0.1,
    ranges=DeformationRanges(scale_share=0.5),
    largest_loss=0.5,
)
_FINETUNE: dict[PresetName, FinetuneConfig] = {
    "tiny": _SMALL_FINETUNE,
    "fast": replace(
        _SMALL_FINETUNE, steps=1000, patch=PatchConfig(samples=2), mixed_precision=True
    ),
    "paper": FinetuneConfig(
        rates=_scaled(_PAPER_RATES, 1.0),
        largest_loss=0.5,
        geometry_weight=0.1,
        origin_distance=0.1,
        keep_distance=True,
        lpips_weight=0.01,
        mixed_precision=True,
    ),
}


def finetune_preset(name: PresetName) -> FinetuneConfig:
    """Return the fine-tuning settings that go with a pre-training preset.

    Raises:
        InputError: there is no such preset.
    """
    if name not in _FINETUNE:
        raise InputError(f"preset: expected one of {', '.join(get_args(PresetName))}, got {name!r}")
    return _FINETUNE[name]


SkinningName = Literal["ours", "paper"]
_SKINNING: dict[SkinningName, SkinningTrainConfig] = {
    "ours": SkinningTrainConfig(),
    "paper": SkinningTrainConfig(
        network=SkinningConfig(along_cloud=False, start_sigma=None), position_weight=0.0
    ),
}


def skinning_preset(name: SkinningName) -> SkinningTrainConfig:
    """Return how a skinning learns inside fine-tuning.

    "ours" starts at the Gaussian over path lengths and adds the direct term; "paper" is what the
    paper says: equal weights of the nearest anchors through space, no term of its own.

    Raises:
        InputError: there is no such preset.
    """
    if name not in _SKINNING:
        raise InputError(f"skinning: expected one of {', '.join(_SKINNING)}, got {name!r}")
    return _SKINNING[name]


def demo_finetune() -> FinetuneConfig:
    """Return the fine-tuning of `tiny`, shortened for the embedded sample."""
    return replace(_FINETUNE["tiny"], steps=350, front_weight=0.3)
