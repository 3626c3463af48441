"""Settings of the training of Gaussians; nothing in them is an absolute length."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace

from pcore.deform.sampler import DeformationRanges
from pcore.errors import InputError
from pcore.gaussians.render import Footprint
from pcore.gaussians.spherical_harmonics import HIGHEST_DEGREE
from pcore.training.config import Background, Exposure, check_positive, check_weights
from pcore.training.schedule import Level, Schedule, check_levels


@dataclass(frozen=True, kw_only=True)
class GaussianRates:
    """Learning rates of Adam, for trainings of some thousand steps.

    3D Gaussian Splatting takes 5e-3, 1e-3, 5e-2, 2.5e-3, 1.25e-4 for its 30,000. With those, 2,400
    steps end 2.8 dB lower (mean of two objects of our own, held-out training views).
    """

    means: Schedule = field(default_factory=lambda: Schedule(base=1.6e-4, final=0.01))
    """In distances of the cameras from the scene's centre (the median)."""
    scales: Schedule = field(default_factory=lambda: Schedule(base=3e-2))
    """Of the logarithms."""
    quats: Schedule = field(default_factory=lambda: Schedule(base=1e-2))
    opacities: Schedule = field(default_factory=lambda: Schedule(base=5e-2))
    """Of the logits."""
    colors: Schedule = field(default_factory=lambda: Schedule(base=2e-2))
    """Of the harmonics of degree 0."""
    harmonics: Schedule = field(default_factory=lambda: Schedule(base=1e-3))
    """Of the others."""

    def named(self) -> dict[str, Schedule]:
        """Schedules by parameter group."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

    def times(self, factor: float) -> GaussianRates:
        """Return `factor` times these rates."""
        named = self.named().items()
        return GaussianRates(
            **{name: replace(rate, base=factor * rate.base) for name, rate in named}
        )


@dataclass(frozen=True, kw_only=True)
class DensityConfig:
    """When Gaussians come and go."""

    every: int = 100
    first: int = 300
    last: float = 0.5
    """Share of the steps after which the number stays."""
    gradient: float = 1e-4
    """Gaussians whose mean gradient of the centre on the screen (per half a picture) is above this
    are doubled: small ones by a copy, large ones by two parts."""
    large: float = 0.01
    """Standard deviation of large ones, in distances of the cameras."""
    shrink: float = 1.6
    """The parts of a large one are smaller by this factor."""
    limit: int = 10_000
    """No more than this in all."""
    faint: float = 0.005
    """Fainter ones go."""
    huge: float = 0.1
    """Larger ones go, in distances of the cameras; only where masks say how large the object is."""


@dataclass(frozen=True, kw_only=True)
class GaussianConfig:
    """Training of Gaussians on one scene."""

    steps: int = 2400
    """Optimiser steps."""
    views: int = 1
    """Photos of a step, whose loss is their mean; processes that train together share them."""
    points: int = 4000
    """Gaussians at the start."""
    start: str = "auto"
    """"hull" (visual hull of the training masks), "sparse" (points of the reconstruction that posed
    the photos, and far ones), "views" (where neighbouring photos agree, and far ones), a PLY or NPY
    file of points, or "auto": the first of these that the scene has."""
    degree: int = 3
    """Of the spherical harmonics."""
    degree_every: float = 1 / 6
    """Share of the steps after which the next degree of the harmonics begins to learn."""
    rates: GaussianRates = field(default_factory=GaussianRates)
    """Learning rates."""
    density: DensityConfig = field(default_factory=DensityConfig)
    """When Gaussians come and go."""
    footprint: Footprint = field(default_factory=Footprint)
    """How Gaussians meet pixels, in training and for good."""
    opacity_start: float = 0.1
    """Opacity of every Gaussian at the start."""
    ssim_weight: float = 0.2
    """Share of 1 - SSIM in the loss; the rest is the absolute error."""
    background: Background = "random"
    """Behind images with alpha; "random" draws another colour every step and renders on white."""
    hold_out: int = 10
    """Every so-manieth training view is kept for validation."""
    held_out_until: float | None = None
    """Share of the steps after which those are learned from as well, and no validation follows: no
    other photo may show what one of them shows (ADR 59). None: they only validate."""
    validate_every: int = 600
    """Steps between validations."""
    save_every: int = 600
    """Steps between saves."""
    seed: int = 0
    """Of every random draw."""
    levels: tuple[Level, ...] | None = None
    """Coarse to fine; from the end of the last one on the photos are whole. None: always."""
    exposure: Exposure = None
    """"per-view" learns an affine map of colours for every photo along; None takes them as they
    are."""
    seconds: float | None = None
    """Promised for all steps, validations and saves; `steps` is then what is foreseen. None makes
    the steps and promises nothing."""

    def __post_init__(self) -> None:
        check_positive(self, "steps", "views", "points", "validate_every", "save_every")
        if not 0 <= self.degree <= HIGHEST_DEGREE:
            raise InputError(
                f"training of Gaussians: expected harmonics of degree 0 to {HIGHEST_DEGREE}, got "
                f"{self.degree}"
            )
        if not (0 < self.opacity_start < 1 and 0 <= self.ssim_weight <= 1):
            raise InputError(
                "training of Gaussians: expected an opacity between 0 and 1 and a weight of the "
                f"SSIM from 0 to 1, got {self.opacity_start} and {self.ssim_weight}"
            )
        if self.held_out_until is not None and not 0 < self.held_out_until < 1:
            raise InputError(
                "training of Gaussians: expected held_out_until between 0 and 1, or none, got "
                f"{self.held_out_until}"
            )
        check_levels(self.levels)
        if not math.isfinite(self.degree_every):
            raise InputError(
                f"training of Gaussians: expected a finite degree_every, got {self.degree_every}"
            )


@dataclass(frozen=True, kw_only=True)
class GaussianFinetuneConfig:
    """Self-supervised fine-tuning of Gaussians (P-CORE on Gaussians, ADR 24)."""

    steps: int = 300
    """Optimiser steps."""
    views: int = 1
    """Photos of a step, with a random field each, whose loss is their mean; processes that tune
    together share them."""
    rays: int = 128
    """Deformed rays of a photo."""
    rates: GaussianRates = field(default_factory=lambda: GaussianRates().times(0.1))
    """Learning rates: a tenth of those of the training, which would undo what is learned."""
    points_only: bool = True
    """Use the mode that deforms Gaussians and keeps the camera."""
    rays_and_points: bool = True
    """Use the mode that deforms Gaussians and ray origins; with both, they take turns."""
    origin_distance: float = 0.1
    """Rays-and-points mode: how far before the surface the moved origins lie, as a fraction of the
    distance between camera and surface."""
    geometry_weight: float = 0.1
    """lambda_geo; L_geo is measured in units of the bounding box's diagonal."""
    texture_weight: float = 0.1
    """lambda_tex; L_tex is the absolute error of the colours against the photo."""
    spread_weight: float = 0.0
    """Of the variance of depth along deformed rays: nothing inside. Off: it costs more than it
    brings (ADR 24)."""
    needle_weight: float = 0.0
    """Of Gaussians longer than `needle` times their second axis; off."""
    needle: float = 4.0
    """See `needle_weight`."""
    foreground_alpha: float = 0.5
    """Rays whose canonical opacity is above this are foreground."""
    reach: float = 0.02
    """Rays that see something farther than this from their target, in diagonals, count nothing:
    the deformation put another part before it."""
    ranges: DeformationRanges = field(default_factory=DeformationRanges)
    """What is drawn."""
    largest_loss: float | None = 0.3
    """The budget: how many dB the PSNR of each held-out training view may lose; as for PAPR."""
    ssim_weight: float = 0.2
    """L_rgb: share of 1 - SSIM; the rest is the absolute error."""
    background: Background = "random"
    """Behind images with alpha."""
    hold_out: int = 10
    """Every so-manieth training view is kept for validation."""
    validate_every: int = 100
    """Steps between validations."""
    save_every: int = 100
    """Steps between saves."""
    seed: int = 0
    """Of every random draw."""

    @property
    def consistent(self) -> bool:
        """Whether any loss looks at a deformed state."""
        return max(self.geometry_weight, self.texture_weight, self.spread_weight) > 0

    def __post_init__(self) -> None:
        check_positive(self, "steps", "views", "rays", "validate_every", "save_every")
        check_weights(self, "geometry_weight", "texture_weight", "spread_weight", "needle_weight")
        if not (self.points_only or self.rays_and_points):
            raise InputError(
                "fine-tuning of Gaussians: expected at least one of points_only and rays_and_points"
            )
        if not (0 < self.origin_distance <= 1 and 0 <= self.ssim_weight <= 1):
            raise InputError(
                "fine-tuning of Gaussians: expected origin_distance above 0 and at most 1 and "
                f"ssim_weight from 0 to 1, got {self.origin_distance} and {self.ssim_weight}"
            )
