"""The paper's ablation: what fine-tuning is without one of its parts, and the figure of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from pcore.errors import InputError
from pcore.evaluation.figures import Pixels, color_pixels, depth_pixels, depth_range, sheet
from pcore.evaluation.runner import Taken
from pcore.evaluation.states import CANONICAL
from pcore.render.image import Image
from pcore.training.config import FinetuneConfig
from pcore.training.gaussian_config import GaussianFinetuneConfig

Settings = TypeVar("Settings", bound=FinetuneConfig | GaussianFinetuneConfig)


@dataclass(frozen=True, kw_only=True)
class Variant:
    """Fine-tuning with a part left out.

    Attributes:
        title: column of the paper's figure.
        folder: name of its run folder.
        changes: fields of the settings that differ from the full method.
    """

    title: str
    folder: str
    changes: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def config(self, full: Settings) -> Settings:
        """Settings of this variant; `full` are those of the whole method."""
        return replace(full, **self.changes)


VARIANTS: tuple[Variant, ...] = (
    Variant(
        title="Photos only",
        folder="photos-only",
        changes={"geometry_weight": 0.0, "texture_weight": 0.0},
    ),
    Variant(title="w/o R&P", folder="without-rays", changes={"rays_and_points": False}),
    Variant(title="w/o Pt-Only", folder="without-points", changes={"points_only": False}),
    Variant(title="w/o L_tex", folder="without-texture", changes={"texture_weight": 0.0}),
    Variant(title="Full", folder="full"),
)
"""The paper's section "Ablation Study", in the order of its figure, and before it what the same
further steps on the photos do without either loss: the gain of fine-tuning counts from there."""
GAUSSIAN_VARIANTS: tuple[Variant, ...] = (
    *VARIANTS[:4],
    Variant(title="w/o L_geo", folder="without-geometry", changes={"geometry_weight": 0.0}),
    Variant(title="+ spread", folder="with-spread", changes={"spread_weight": 1.0}),
    Variant(title="+ needles", folder="with-needles", changes={"needle_weight": 0.01}),
    Variant(title="Full", folder="full"),
)
"""The same for Gaussians, and what their regularisers would do."""


def variants_for(full: FinetuneConfig | GaussianFinetuneConfig) -> tuple[Variant, ...]:
    """Columns of the ablation of an object with these settings."""
    return GAUSSIAN_VARIANTS if isinstance(full, GaussianFinetuneConfig) else VARIANTS


class AblationFigure:
    """Collects the pictures of one test view while they are taken; gives the paper's figure."""

    def __init__(self, state: str, view: int) -> None:
        """Collect view number `view` of `state` and of the canonical scene."""
        self._state, self._view = state, view
        self._canonical: Taken | None = None
        self._deformed: Taken | None = None

    def __call__(self, taken: Taken) -> None:
        """Keep what the figure shows; to be handed to `evaluate`."""
        if taken.index != self._view:
            return
        if taken.state == CANONICAL:
            self._canonical = taken
        if taken.state == self._state:
            self._deformed = taken

    def pixels(self, methods: Sequence[str]) -> Pixels:
        """Columns Canonical and every method, rows Rendering and Depth Map.

        The canonical column is vanilla PAPR's. Depth maps of the state share one colour scale,
        that of the method with the most complete surface (the last one).

        Args:
            methods: names in the order of the columns; vanilla PAPR first.

        Raises:
            InputError: the scene has no test view of that number.
        """
        if self._canonical is None or self._deformed is None:
            raise InputError(
                f"figure: there is no test view number {self._view} of {self._state}; choose a "
                "smaller one with --view (the first is 0)"
            )
        first = self._canonical.photos[methods[0]]
        photos = [self._deformed.photos[name] for name in methods]
        colors = [color_pixels(photo.rgb) for photo in (first, *photos)]
        depths = [_depth(first, first), *(_depth(photo, photos[-1]) for photo in photos)]
        rows = [("Rendering", colors), ("Depth Map", depths)]
        return sheet(["Canonical", *methods], rows, cell=240)


def _depth(photo: Image, scale: Image) -> Pixels:
    return depth_pixels(photo.alpha, photo.depth, depth_range([(scale.alpha, scale.depth)]))
