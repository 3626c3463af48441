"""What makes one PAPR model differ from another: sizes, constants, and the three presets."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.pixel_samples import check_samples

COLOR_CHANNELS = 3
"""Features of a point that are its colour (`PaprConfig.point_colors`)."""
HIGHEST_COLOR_DEGREE = 2
"""More has not been tried: nine numbers per channel are most of a small model's features."""


@dataclass(frozen=True, kw_only=True)
class MlpConfig:
    """Shape of one embedding network."""

    layers: int
    """Number of linear layers."""
    width: int = 256
    """Hidden width."""
    size: int = 256
    """Width of the output."""
    skip_after: int | None = None
    """Concatenate the network's own input behind the output of this layer (1 is the first)."""

    def __post_init__(self) -> None:
        if self.layers < 2 or self.width < 1 or self.size < 1:
            raise InputError(
                f"MLP: expected at least 2 layers and positive widths, got {self.layers} layers, "
                f"width {self.width}, output {self.size}"
            )
        if self.skip_after is not None and not 1 <= self.skip_after < self.layers:
            raise InputError(
                f"MLP: expected skip_after between 1 and {self.layers - 1}, got {self.skip_after}"
            )


@dataclass(frozen=True, kw_only=True)
class Octaves:
    """Octaves of the positional encodings of what a ray and a point are to each other.

    The original has one number L for all of them. Waves shorter than what photos can tell apart
    only help to learn them by heart (ADR 9). With 0 octaves a part stays as it is, in units of the
    networks' frame.
    """

    point: int = 6
    """Of the point's position; sets one point apart from another, never one view."""
    along: int = 6
    """Of the part h of its offset along the ray. That is the view's direction, times the depth from
    the ray's origin: its waves tell views apart."""
    across: int = 6
    """Of the part t across the ray; waves much shorter than two pixels tell pixels of photos apart,
    not surfaces."""
    direction: int = 6
    """Of the ray's direction."""

    def __post_init__(self) -> None:
        if min(self.point, self.along, self.across, self.direction) < 0:
            raise InputError(
                "PAPR: expected octaves of at least 0, got "
                f"{self.point}, {self.along}, {self.across}, {self.direction}"
            )

    @classmethod
    def all(cls, number: int) -> Octaves:
        """Return the same number for all, as in the original."""
        return cls(point=number, along=number, across=number, direction=number)


@dataclass(frozen=True, kw_only=True)
class ReferenceOrigin:
    """Where every ray begins, whatever the camera: at a distance before the middle of the scene."""

    center: tuple[float, float, float]
    """Middle of the scene, world units."""
    distance: float
    """From a ray's origin to where it passes the center, world units."""

    def __post_init__(self) -> None:
        _check_place(self.center, self.distance, "distance of the reference origin")


@dataclass(frozen=True, kw_only=True)
class NetworkFrame:
    """The coordinates that networks see: world coordinates about a middle, in another unit."""

    center: tuple[float, float, float]
    """What is the origin there, world units."""
    unit: float
    """What is 1 there, world units."""

    def __post_init__(self) -> None:
        _check_place(self.center, self.unit, "unit of the networks' frame")

    def from_world(self, places: Tensor) -> Tensor:
        """Places (..., 3), world units, in this frame."""
        return (places - places.new_tensor(self.center)) / self.unit


@dataclass(frozen=True, kw_only=True)
class PaprConfig:
    """Architecture of PAPR; the defaults are the original's `chair` configuration."""

    neighbours: int = 20
    """Points that a ray attends to (k)."""
    coord_scale: float = 10.0
    """Positions in the networks' frame are multiplied by this before they are encoded."""
    frame: NetworkFrame | None = None
    """What networks see places in, so that units and origin of the world do not matter. None (the
    original): world coordinates. Training chooses it from the scene where it is None."""
    octaves: Octaves = field(default_factory=Octaves)
    """Octaves of the positional encodings."""
    feature_size: int = 64
    """Length of a point's feature vector mu."""
    point_colors: bool = False
    """The first three features of a point are its colour, which goes around the networks: the
    renderer network sees the blend of colours in the place of its first three channels, and adds
    to it. False (the original): networks make all of a colour."""
    color_degree: int = 0
    """Degree of the harmonics by which those colours depend on where a point is seen from. Their
    coefficients are the next features, harmonic by harmonic, red, green, blue. 0: they do not."""
    key: MlpConfig = field(default_factory=lambda: MlpConfig(layers=5))
    """Network that embeds a point as seen from a ray; normalised before and after."""
    query: MlpConfig = field(default_factory=lambda: MlpConfig(layers=5))
    """Network that embeds a ray's direction; normalised before and after."""
    value: MlpConfig = field(default_factory=lambda: MlpConfig(layers=8, size=32))
    """Network that embeds what a point contributes to a ray's feature."""
    negative_slope: float = 0.0
    """Slope of the leaky ReLU inside the embedding networks (0 is ReLU, `lego` uses 0.2)."""
    background_score: float = 5.0
    """Constant attention score of the background."""
    unet_channels: tuple[int, int, int] = (128, 256, 512)
    """Channels of the renderer at full, half and quarter resolution."""
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Colour that shows where no point answers, RGB in [0, 1]."""
    cutoff: float | None = None
    """Points farther than this from a ray (world units) get no attention; rays without any are
    pure background and cost nothing. None (the original) lets every point answer every ray."""
    reference: ReferenceOrigin | None = None
    """Slide the origins of all rays to this distance before they are seen, so that the camera's
    distance does not matter. None (the original) lets rays begin at the camera."""
    samples: int = 1
    """Rays per pixel of a picture, on a square grid (1, 4, 9, ...): the renderer network sees the
    mean of their features. 1 (the original) is the ray through the pixel's centre."""
    pixel: float | None = None
    """Width of a pixel of the training photos at the object's middle, world units: what the
    renderer network knows (`pcore.render.raster`). None: pictures are drawn as they come."""

    @property
    def color_features(self) -> int:
        """How many features of a point, the first ones, are its colour."""
        return COLOR_CHANNELS * (self.color_degree + 1) ** 2 if self.point_colors else 0

    @property
    def unit(self) -> float:
        """World units in one unit of the networks' frame."""
        return 1.0 if self.frame is None else self.frame.unit

    def __post_init__(self) -> None:
        if self.neighbours < 1 or self.feature_size < 1:
            raise InputError(
                "PAPR: expected neighbours and feature_size of at least 1, got "
                f"{self.neighbours} and {self.feature_size}"
            )
        if min(self.unet_channels) < 1:
            raise InputError(
                f"PAPR: expected unet_channels of at least 1, got {self.unet_channels}"
            )
        self._check_colors()
        check_samples("PAPR", self.samples)
        if self.pixel is not None and not (math.isfinite(self.pixel) and self.pixel > 0):
            raise InputError(
                f"PAPR: expected a pixel of the photos wider than 0, got {self.pixel}; None where "
                "it is not known"
            )
        if self.key.size != self.query.size:
            raise InputError(
                "PAPR: expected key and query embeddings of one size, got "
                f"{self.key.size} and {self.query.size}"
            )
        if self.coord_scale <= 0 or (self.cutoff is not None and self.cutoff <= 0):
            raise InputError(
                "PAPR: expected a positive coord_scale and cutoff, got "
                f"{self.coord_scale} and {self.cutoff}"
            )

    def _check_colors(self) -> None:
        degree = self.color_degree
        if not 0 <= degree <= (HIGHEST_COLOR_DEGREE if self.point_colors else 0):
            raise InputError(
                f"PAPR: expected color_degree from 0 to {HIGHEST_COLOR_DEGREE}, and 0 where points "
                f"have no colours, got {degree}"
            )
        if self.feature_size < self.color_features or (
            self.point_colors and self.value.size < COLOR_CHANNELS
        ):
            raise InputError(
                f"PAPR: expected features of at least {self.color_features} and values of at least "
                f"{COLOR_CHANNELS} numbers where points have colours of degree {degree}, got "
                f"{self.feature_size} and {self.value.size}"
            )


def _check_place(center: tuple[float, float, float], length: float, what: str) -> None:
    if not all(math.isfinite(x) for x in (*center, length)) or length <= 0:
        raise InputError(
            f"PAPR: expected a finite center and a positive {what}, got {center} and {length}"
        )
