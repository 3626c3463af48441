"""Settings of pre-training and fine-tuning, and the presets."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from pcore.contrib.learned_skinning import SkinningConfig
from pcore.deform.sampler import DeformationRanges
from pcore.errors import InputError
from pcore.geometry.farthest_points import ANCHORS
from pcore.model.papr_config import PaprConfig
from pcore.training.schedule import Level, Schedule, check_levels
from pcore.validation import check_count

PresetName = Literal["tiny", "fast", "paper"]
TrunkName = Literal["alex", "squeeze", "vgg"]
Background = Literal["white", "black", "random"]
Exposure = Literal["per-view"] | None
Origin = Literal["camera", "reference"]


@dataclass(frozen=True, kw_only=True)
class Rates:
    """Learning rates; that of the points is in units of the networks' frame times coord_scale."""

    points: Schedule
    attention: Schedule
    features: Schedule
    influence: Schedule
    unet: Schedule

    def named(self) -> dict[str, Schedule]:
        """Schedules by parameter group."""
        return {one.name: getattr(self, one.name) for one in fields(self)}


@dataclass(frozen=True, kw_only=True)
class PatchConfig:
    """Which rays a step sees."""

    side: int = 160
    """Side of a square patch in pixels; images smaller than it are taken whole."""
    views: int = 1
    """Patches per step, each of a random training view."""
    samples: int = 1
    """Rays per pixel, drawn anew in every step. 1 (the original) is the one through its centre."""

    def __post_init__(self) -> None:
        if self.side < 4 or self.views < 1 or self.samples < 1:
            raise InputError(
                "patches: expected a side of at least 4 pixels, at least 1 view and at least 1 ray "
                f"per pixel, got {self.side}, {self.views} and {self.samples}"
            )


@dataclass(frozen=True, kw_only=True)
class PruneConfig:
    """When points of little influence go."""

    every: int = 500
    first: int = 10_000
    last: int = 150_000
    threshold: float = 0.0
    """Points whose influence is not above this are removed."""
    raised: float | None = None
    """Threshold of the steps after `raise_after`; None keeps the first."""
    raise_after: int = 40_000
    """Last step of the first threshold; a raised one waits until the influences have grown."""

    def threshold_at(self, step: int) -> float:
        """Threshold of a step."""
        return self.threshold if self.raised is None or step <= self.raise_after else self.raised


@dataclass(frozen=True, kw_only=True)
class GrowConfig:
    """When points are added where the cloud is uneven."""

    every: int = 1000
    first: int = 20_000
    last: int = 70_000
    count: int = 1000
    limit: int = 30_000
    """No more points than this in all."""


@dataclass(frozen=True, kw_only=True)
class PretrainConfig:
    """Pre-training of PAPR on one scene; the defaults are the original's schedule."""

    model: PaprConfig = field(default_factory=PaprConfig)
    """Architecture."""
    origin: Origin = "camera"
    """Where rays begin for the networks: "camera" (the original), or "reference": at the
    radius of the object's region before its middle, whatever camera renders. So near, the part of a
    point's offset along the ray changes with depth as much as with the view's direction."""
    steps: int = 250_000
    """Optimiser steps."""
    patch: PatchConfig = field(default_factory=PatchConfig)
    """Rays of a step."""
    rates: Rates
    """Learning rates."""
    points: int = 3000
    """Points at the start."""
    start: str = "hull"
    """"hull" (visual hull of the training masks), "grid" (the original's) or a PLY or NPY file."""
    influence_start: float = 0.0
    """Influence of every point at the start."""
    feature_spread: float = 1.0
    """Standard deviation of the random features at the start."""
    lpips_weight: float = 0.0
    """Weight of the LPIPS loss; its weights must be on this machine when it is positive."""
    lpips_trunk: TrunkName = "vgg"
    """Network of the LPIPS loss."""
    opacity_weight: float = 0.0
    """Weight of the squared error of the opacity against the alpha channel, where there is one."""
    front_weight: float = 0.0
    """Weight of attention behind the first point of a ray (squared units of the networks)."""
    background: Background = "white"
    """Behind images with alpha; "random" draws another colour every step and renders on white."""
    prune: PruneConfig | None = None
    """Removal of points; None keeps all."""
    grow: GrowConfig | None = None
    """Addition of points; None adds none."""
    hold_out: int = 10
    """Every so-manieth training view is kept for validation."""
    validate_every: int = 5000
    """Steps between validations."""
    save_every: int = 5000
    """Steps between saves."""
    mixed_precision: bool = False
    """Half precision on a GPU; the CPU always computes in float32."""
    seed: int = 0
    """Of every random draw."""
    levels: tuple[Level, ...] | None = None
    """Coarse to fine; None: photos are whole from the start."""
    exposure: Exposure = None
    """"per-view" learns an affine map of colours for every photo along."""
    seconds: float | None = None
    """Promised for all steps, validations and saves; `steps` is then what is foreseen."""

    def __post_init__(self) -> None:
        check_levels(self.levels)
        check_positive(self, "steps", "points", "validate_every", "save_every")
        check_weights(self, "lpips_weight", "opacity_weight", "front_weight")


@dataclass(frozen=True, kw_only=True)
class SkinningTrainConfig:
    """Skinning that learns along with the renderer (paper, "Skinning Weights Optimization").

    Points and surface points then move by the skinning, rays by the field. The presets are
    `pcore.training.presets.skinning_preset`.
    """

    network: SkinningConfig = field(default_factory=SkinningConfig)
    """The skinning network and where its weights start."""
    anchors: int = ANCHORS
    """Anchors, chosen from the cloud by farthest point sampling."""
    rate: Schedule = field(default_factory=lambda: Schedule(base=2e-3, warmup=20))
    """Learning rate of the skinning network; a base of 0 keeps its weights as they start."""
    position_weight: float = 100.0
    """Weight of the direct term: mean squared distance of skinned points from where the field takes
    them, in squared bounding-box diagonals of the cloud. 0 leaves it out."""
    surface_target: Literal["skinned", "field"] = "skinned"
    """Where L_geo wants canonical surface points: where the skinning takes them, with gradient (the
    paper), or where the field does."""

    def __post_init__(self) -> None:
        check_count("skinning: anchors", self.anchors)
        if self.anchors < 2 or not 0 <= self.rate.base < math.inf:
            raise InputError(
                "skinning: expected at least 2 anchors and a finite learning rate of 0 or more, "
                f"got {self.anchors} and {self.rate.base}"
            )
        check_weights(self, "position_weight")


@dataclass(frozen=True, kw_only=True)
class FinetuneConfig:
    """Self-supervised fine-tuning (paper, "Self-Supervised Fine-Tuning Objective")."""

    steps: int = 500
    """Optimiser steps."""
    patch: PatchConfig = field(default_factory=PatchConfig)
    """Rays of a step."""
    rates: Rates
    """Learning rates."""
    aware: bool = False
    """Render deformed states with deformation-aware rays, as such a model will be used: only what
    no local frame explains is left to learn. False is the paper's method."""
    points_only: bool = True
    """Use the mode that deforms points and keeps the camera."""
    rays_and_points: bool = True
    """Use the mode that deforms points and ray origins."""
    alternate: bool = False
    """With both modes: one per step in turn, instead of the sum of both in every step."""
    geometry_weight: float = 1.0
    """lambda_geo; L_geo is measured in units of the cloud's bounding-box diagonal."""
    texture_weight: float = 1.0
    """lambda_tex."""
    origin_distance: float = 0.5
    """Rays-and-points mode: how far before the surface the moved origins lie, as a fraction of the
    distance between camera and surface."""
    keep_distance: bool = False
    """Rays-and-points mode: slide the deformed origins back along their rays to the distance that
    the camera had, so that the network sees no distance it was not trained on."""
    background_rays: bool = True
    """Deform rays of the background as well and ask them to stay background; otherwise only rays
    of the foreground enter L_tex."""
    texture_target: Literal["rendering", "photo"] = "rendering"
    """What the deformed rendering is compared with: the canonical rendering (the paper) or the
    training photo of the same rays."""
    foreground_alpha: float = 0.5
    """Rays whose canonical opacity is above this are foreground."""
    opacity_weight: float = 0.0
    """Weight of the squared error of the canonical opacity against the alpha channel."""
    front_weight: float = 0.0
    """Weight of attention behind the first point of a ray (squared units of the networks)."""
    lpips_weight: float = 0.0
    """Weight of LPIPS in the canonical photometric loss."""
    lpips_trunk: TrunkName = "vgg"
    """Network of the LPIPS loss."""
    ranges: DeformationRanges = field(default_factory=DeformationRanges)
    """What is drawn."""
    skinning: SkinningTrainConfig | None = None
    """Move points and surface points by a skinning that learns as well; None leaves that to the
    field."""
    largest_loss: float | None = None
    """The budget: how many dB the PSNR of each held-out training view may lose. Where one
    loses more by the last weights, the result is as much of the way to them as meets it
    (`pcore.training.budget`). None takes the last weights whatever they cost."""
    background: Background = "white"
    """Behind images with alpha."""
    hold_out: int = 10
    """Every so-manieth training view is kept for validation."""
    validate_every: int = 100
    """Steps between validations."""
    save_every: int = 100
    """Steps between saves."""
    mixed_precision: bool = False
    """Half precision on a GPU."""
    seed: int = 0
    """Of every random draw."""

    def __post_init__(self) -> None:
        check_positive(self, "steps", "validate_every", "save_every")
        check_weights(self, "geometry_weight", "texture_weight")
        check_weights(self, "lpips_weight", "opacity_weight", "front_weight")
        if not (self.points_only or self.rays_and_points):
            raise InputError(
                "fine-tuning: expected at least one of points_only and rays_and_points"
            )
        if not 0 < self.origin_distance <= 1:
            raise InputError(
                "fine-tuning: expected origin_distance above 0 and at most 1, got "
                f"{self.origin_distance}"
            )


def check_positive(config: Any, *names: str) -> None:
    """Refuse numbers below 1, all views held out, and seeds that torch's generators do not take."""
    for name in names:
        value = getattr(config, name)
        if value < 1:
            raise InputError(f"{type(config).__name__}: expected {name} >= 1, got {value}")
    if config.hold_out < 2:
        raise InputError(
            f"{type(config).__name__}: expected hold_out of at least 2, got {config.hold_out}"
        )
    if not 0 <= config.seed < 2**63 - 1:
        raise InputError(
            f"{type(config).__name__}: expected a seed from 0 to 2**63 - 2, got {config.seed}"
        )


def check_weights(config: Any, *names: str) -> None:
    """Refuse negative weights of losses, which would reward errors, and infinity and NaN."""
    for name in names:
        value = getattr(config, name)
        if not 0 <= value < math.inf:
            raise InputError(
                f"{type(config).__name__}: expected {name} to be a finite number of 0 or more, got "
                f"{value}; 0 leaves this loss out"
            )
