"""Settings of a fit of a pose to photos."""

from __future__ import annotations

from dataclasses import dataclass, field

from pcore.errors import InputError
from pcore.geometry.farthest_points import ANCHORS
from pcore.rivals.motion_stages import MotionConfig
from pcore.validation import check_count


@dataclass(frozen=True, kw_only=True)
class FitStage:
    """One stage of a fit, from coarse to fine.

    Attributes:
        pixels: longest side of its pictures at most.
        steps: of Adam.
        rate: length of a step at first: mean spacings of the anchors, and radians.
        stiffness: weight of as rigid as possible against the error of the pictures.
        spread: how far a step is handed on along the graph of anchors: gradients are multiplied by
            (1 + spread * L)^-1 with its Laplacian L (Nicolet et al. 2021).
    """

    pixels: int
    steps: int
    rate: float
    stiffness: float
    spread: float


STAGES = (
    FitStage(pixels=7, steps=100, rate=0.3, stiffness=0.1, spread=5.0),
    FitStage(pixels=13, steps=120, rate=0.3, stiffness=0.05, spread=3.0),
    FitStage(pixels=25, steps=150, rate=0.2, stiffness=0.02, spread=2.0),
    FitStage(pixels=50, steps=150, rate=0.1, stiffness=0.02, spread=1.0),
    FitStage(pixels=50, steps=200, rate=0.1, stiffness=0.003, spread=0.3),
    FitStage(pixels=100, steps=400, rate=0.05, stiffness=0.001, spread=0.1),
)
"""Chosen on figures of limbs (docs/research/fit.md)."""
PART_STAGES = (
    FitStage(pixels=50, steps=100, rate=0.1, stiffness=0.01, spread=0.0),
    FitStage(pixels=100, steps=150, rate=0.05, stiffness=0.003, spread=0.0),
)
JOINTED = FitStage(pixels=100, steps=250, rate=0.05, stiffness=0.1, spread=0.5)
"""Of rigid parts, and of all anchors with joints between these; chosen like the others."""
SEARCHED = 2
"""Last coarse stages that follow a search from the start."""


@dataclass(frozen=True, kw_only=True)
class SearchConfig:
    """How limbs that moved far are looked for.

    Attributes:
        sweeps: over all limbs, at most; 0 searches nothing.
        pixels: longest side of the pictures at most.
        points: that are drawn in them.
    """

    sweeps: int = 8
    pixels: int = 25
    points: int = 3000

    def __post_init__(self) -> None:
        check_count("fit: sweeps", self.sweeps, minimum=0)
        check_count("fit: points", self.points)


@dataclass(frozen=True, kw_only=True)
class FitConfig:
    """How a pose is fitted.

    Attributes:
        anchors: how many carry the object at last; all of them are handles of the edit.
        coarse_anchors: how many carry it in the search and the coarse stages, at most.
        seed: of the choice of the anchors, of the order of photos and of the search.
        views: photos per step.
        silhouettes: compare outlines only, not colours: photos that are masks.
        stages: from coarse to fine.
        coarse: how many of the stages are coarse.
        parts: stages after them of rigid parts, whose motions were found; none leaves them out.
        jointed: last stage of all anchors, which bend between the parts.
        search: for limbs that moved far.
        relight: steps after which the light on the moved object is computed anew.
    """

    anchors: int = 512
    coarse_anchors: int = ANCHORS
    seed: int = 0
    views: int = 2
    silhouettes: bool = False
    stages: tuple[FitStage, ...] = STAGES
    coarse: int = 4
    parts: tuple[FitStage, ...] = PART_STAGES
    jointed: FitStage = JOINTED
    search: SearchConfig = field(default_factory=SearchConfig)
    relight: int = 40

    def __post_init__(self) -> None:
        check_count("fit: anchors", self.anchors, minimum=2)
        check_count("fit: coarse anchors", self.coarse_anchors, minimum=2)
        check_count("fit: photos per step", self.views)
        check_count("fit: stages", len(self.stages))
        check_count("fit: steps between lights", self.relight)
        if not 1 <= self.coarse <= len(self.stages):
            raise InputError(
                f"fit: expected 1 <= coarse stages <= stages, got {self.coarse} and "
                f"{len(self.stages)}"
            )

    @property
    def steps(self) -> int:
        """Steps of all stages of all tries, and sweeps of both searches."""
        coarse = self.stages[: self.coarse]
        parts = (*self.parts, self.jointed) if self.parts else ()
        all_stages = (*self.stages, *coarse[-SEARCHED:], *coarse[-1:], *parts)
        return 2 * self.search.sweeps + sum(stage.steps for stage in all_stages)


@dataclass(frozen=True, kw_only=True)
class AppearanceConfig:
    """How colours follow photos of a pose.

    Attributes:
        pixels: longest side of the pictures of Gaussians at most.
        steps: of Adam, for Gaussians.
        rate: length of a step at first, of the first coefficient of their colours.
        views: photos per step of theirs.
        seed: of the order of photos.
        points: of neural points, as in PAPR in Motion's second stage; no more rays per pixel than
            the object's pictures have.
    """

    pixels: int = 200
    steps: int = 150
    rate: float = 0.03
    views: int = 2
    seed: int = 0
    points: MotionConfig = field(default_factory=lambda: MotionConfig(steps=300, samples=2))

    def __post_init__(self) -> None:
        check_count("appearance: steps", self.steps)
        check_count("appearance: photos per step", self.views)
