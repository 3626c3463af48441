"""Settings of a fit of a pose to photos."""

from __future__ import annotations

from dataclasses import dataclass

from pcore.errors import InputError
from pcore.geometry.farthest_points import ANCHORS
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


@dataclass(frozen=True, kw_only=True)
class FitConfig:
    """How a pose is fitted.

    Attributes:
        anchors: how many carry the object; all of them are handles of the edit that is found.
        seed: of the choice of the anchors and of the order of photos.
        views: photos per step.
        silhouettes: compare outlines only, not colours: photos that are masks.
        stages: from coarse to fine.
        coarse: how many of the stages every try goes through; the best try goes on.
        tries: the first begins with the first stage, the second with the second, and so on: small
            pictures find what has moved far, and can lose what has not.
        relight: steps after which the light on the moved object is computed anew.
    """

    anchors: int = ANCHORS
    seed: int = 0
    views: int = 2
    silhouettes: bool = False
    stages: tuple[FitStage, ...] = STAGES
    coarse: int = 4
    tries: int = 3
    relight: int = 40

    def __post_init__(self) -> None:
        check_count("fit: anchors", self.anchors, minimum=2)
        check_count("fit: photos per step", self.views)
        check_count("fit: stages", len(self.stages))
        check_count("fit: steps between lights", self.relight)
        if not 1 <= self.tries <= self.coarse <= len(self.stages):
            raise InputError(
                "fit: expected 1 <= tries <= coarse stages <= stages, got "
                f"{self.tries}, {self.coarse} and {len(self.stages)}"
            )

    @property
    def steps(self) -> int:
        """Steps of all stages of all tries."""
        tries = [self.stages[first : self.coarse] for first in range(self.tries)]
        return sum(stage.steps for part in (*tries, self.stages[self.coarse :]) for stage in part)


@dataclass(frozen=True, kw_only=True)
class AppearanceConfig:
    """How colours follow photos of a pose.

    Attributes:
        pixels: longest side of the pictures at most.
        steps: of Adam.
        rate: length of a step at first, of the first coefficient of the colours.
        views: photos per step.
        seed: of the order of photos.
    """

    pixels: int = 200
    steps: int = 150
    rate: float = 0.03
    views: int = 2
    seed: int = 0

    def __post_init__(self) -> None:
        check_count("appearance: steps", self.steps)
        check_count("appearance: photos per step", self.views)
