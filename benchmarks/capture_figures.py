"""One figure beside its bar, and what rows of captures that train have in common."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.commands import run_pcore
from pcore.asset.content import LightName
from pcore.errors import PcoreError
from pcore.evaluation.methods import methods_of, open_subject
from pcore.evaluation.protocol import STANDARD
from pcore.evaluation.runner import evaluate
from pcore.evaluation.states import CANONICAL, open_states
from pcore.evaluation.summary import StateMean, state_means
from pcore.files.run_record import begun


@dataclass(frozen=True)
class Place:
    """Where a row finds its data, a folder of its own, and threads (None: all cores)."""

    data: Path
    folder: Path
    threads: int | None = None


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One figure beside its bar.

    Attributes:
        what: in words, with its unit.
        value: NaN where it is not known.
        bar: what it is to keep.
        at_most: whether the bar is the most that it may be, else the least.
    """

    what: str
    value: float
    bar: float
    at_most: bool = False

    @property
    def kept(self) -> bool:
        """Whether the bar is kept; what is not known keeps none."""
        return self.value <= self.bar if self.at_most else self.value >= self.bar

    @property
    def bar_text(self) -> str:
        """The bar in words."""
        return f"at {'most' if self.at_most else 'least'} {self.bar:g}"

    @property
    def value_text(self) -> str:
        """The figure with four digits."""
        return f"{self.value:.4g}"


def trained(
    place: Place, scene: str, *, factor: int, minutes: float, masks: str | None = None
) -> Figure:
    """Train Gaussians with a promise unless they are, and say how well it was kept."""
    going = begun(place.folder)
    start = time.monotonic()
    promise = ["--minutes", str(minutes), *([] if masks is None else ["--masks", masks])]
    train(place, place.data / scene, place.folder, factor, *promise)
    took = time.monotonic() - start
    # Of a training that went on, nobody knows what it took in one piece.
    off = math.nan if going else 100 * abs(took / (60 * minutes) - 1)
    what = f"off the promise of {minutes:g} minutes, %"
    return Figure(what=what, value=off, bar=20, at_most=True)


def train(place: Place, scene: Path, run: Path, factor: int, *words: str) -> None:
    """Train Gaussians by the command; a training that was begun goes on."""
    going = ["--resume"] if begun(run) else []
    fixed = ["--factor", str(factor), "--no-tensorboard", *going]
    command(place, "train", str(scene), "-o", str(run), *fixed, *words)


def command(place: Place, *words: str) -> None:
    """Call `pcore` in a process of its own, as a user does.

    Raises:
        PcoreError: it failed.
    """
    threads = [] if place.threads is None else ["--threads", str(place.threads)]
    code = run_pcore(*words, *threads)
    if code:
        raise PcoreError(f"pcore {' '.join(words)}: expected exit code 0, got {code}; it says why")


def processor_seconds() -> float:
    """Of this process and of all that it waited for."""
    return sum(os.times()[:4])


def scored(place: Place, metric: str, bar: float) -> Figure:
    """Mean over the test views, dB."""
    whole = "whole picture" if metric == "psnr" else "object"
    return Figure(what=f"PSNR, {whole}, dB", value=means(place.folder)[metric], bar=bar)


def means(run: Path) -> Mapping[str, float]:
    """Mean scores of a run on the test views of its scene."""
    scores = scores_of(run, [CANONICAL], light="baked")[0].scores
    return {name: math.nan if value is None else value for name, value in scores.items()}


def scores_of(
    run: Path, states: Sequence[str], *, light: LightName | None = None
) -> list[StateMean]:
    """Means over the test views of states of the scene that a run was trained on."""
    asset = open_subject(run)
    record = asset.record
    places = open_states(record.scene_or(None), factor=record.factor, masks=record.masks)
    methods = methods_of([asset], places.scene, rays="aware", light=light)
    return state_means(evaluate(methods, places.select(states), protocols=[STANDARD]))
