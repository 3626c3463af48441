"""What training loops tell the outside, and listeners that write it down.

The loops are silent: they call a `Listener` with events. A loop saves the state of step s after
all reports of step s, so a log that is cut behind s and continued has every report exactly once.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from pcore.files.closing import Closing
from pcore.files.run_folder import write_guard
from pcore.packages import package


def _no_figures() -> dict[str, float]:
    return {}


@dataclass(frozen=True, kw_only=True)
class StepReport:
    """One training step, or the mean of a few."""

    stage: str
    step: int
    """Steps done."""
    steps: int
    """Steps in all."""
    loss: float
    losses: Mapping[str, float] = field(default_factory=_no_figures)
    """The weighted terms of the loss by name."""
    psnr: float | None = None
    """Of the training patch, decibels."""
    points: int
    seconds_left: float | None = None
    rates: Mapping[str, float] = field(default_factory=_no_figures)
    """Learning rates by parameter group."""


@dataclass(frozen=True, kw_only=True)
class ValidationReport:
    """Figures on held-out training views."""

    stage: str
    step: int
    psnr: float
    """Mean over the views, decibels."""
    views: int
    scores: Mapping[str, float] = field(default_factory=_no_figures)
    """Other figures by name."""
    best: bool
    """Whether no earlier validation was better."""
    accepted: bool = True
    """Whether these weights may become the result."""
    learned_next: bool = False
    """Whether the views are learned from as well after this."""


@dataclass(frozen=True, kw_only=True)
class BudgetReport:
    """How much of a stage's change became the result, and what it cost on held-out views."""

    stage: str
    step: int
    share: float
    """Part of the way from the weights before (0) to the last ones (1)."""
    before: float
    """PSNR before the stage, decibels."""
    after: float
    """Of the last weights, decibels."""
    psnr: float
    """Of the result, decibels."""
    largest_loss: float
    """The budget, decibels: no held-out view lost more."""


@dataclass(frozen=True, kw_only=True)
class PopulationReport:
    """Points were pruned or grown."""

    stage: str
    step: int
    pruned: int
    grown: int
    points: int
    """Points afterwards."""


@dataclass(frozen=True, kw_only=True)
class SurfaceReport:
    """At the end, the training views tell where the surface over the points is."""

    stage: str
    step: int
    views: int


@dataclass(frozen=True, kw_only=True)
class Saved:
    """A file is complete on the disk."""

    stage: str
    step: int
    path: str


@dataclass(frozen=True, kw_only=True)
class Stopped:
    """The loop ended; everything of `step` is saved."""

    stage: str
    step: int
    reason: Literal["finished", "interrupted"]
    message: str = ""
    """For people: why, and how to go on."""


Event = (
    StepReport
    | ValidationReport
    | BudgetReport
    | PopulationReport
    | SurfaceReport
    | Saved
    | Stopped
)
Listener = Callable[[Event], None]

_NAMES: dict[type, str] = {
    StepReport: "step",
    ValidationReport: "validation",
    BudgetReport: "budget",
    PopulationReport: "population",
    SurfaceReport: "surface",
    Saved: "saved",
    Stopped: "stopped",
}


def silent(event: Event) -> None:
    """Listen to nothing."""


def fan_out(*listeners: Listener) -> Listener:
    """Return a listener that hands every event to all of these, in order."""

    def tell(event: Event) -> None:
        for listener in listeners:
            listener(event)

    return tell


class JsonLinesLog(Closing):
    """Appends every event as one line of JSON; `{"event": "step", "stage": ..., ...}`.

    Numbers that are not finite are written as null. Use it in a `with` statement.
    """

    def __init__(self, path: Path, *, resumed: tuple[str, int] | None = None) -> None:
        """Open the log.

        Args:
            path: the file; its folder must exist.
            resumed: (stage, step) of the state that training goes on from: later lines of that
                stage are cut off, so that no step stands there twice.

        Raises:
            TrainingError: the file cannot be written.
        """
        self._path = path
        with write_guard(path):
            if path.is_file():
                _cut(path, resumed)
            self._file = path.open("a", encoding="utf-8", buffering=1)

    def __call__(self, event: Event) -> None:
        """Write one line; raises TrainingError when the disk is full."""
        record = {"event": _NAMES[type(event)], **asdict(event)}
        with write_guard(self._path):
            self._file.write(json.dumps(_finite(record)) + "\n")

    def close(self) -> None:
        """Close the file."""
        with write_guard(self._path):
            self._file.close()


class TensorBoardLog(Closing):
    """Writes losses, PSNR, points and rates for TensorBoard. Use it in a `with` statement."""

    def __init__(self, folder: Path, *, resumed: tuple[str, int] | None = None) -> None:
        """Open the log.

        Args:
            folder: for its event files.
            resumed: as for `JsonLinesLog`; TensorBoard then hides the later points of old files.

        Raises:
            DependencyError: `tensorboard` is not installed.
            TrainingError: the folder cannot be written.
        """
        writer = package(
            "torch.utils.tensorboard.writer",
            extra="log",
            need="the TensorBoard log needs",
            named="tensorboard",
            instead="or train without it (log.jsonl is always written)",
        )
        self._folder = folder
        with write_guard(folder):
            self._writer: Any = writer.SummaryWriter(
                str(folder), purge_step=None if resumed is None else resumed[1] + 1
            )

    def __call__(self, event: Event) -> None:
        """Write the figures of one event."""
        with write_guard(self._folder):
            for name, value in _scalars(event).items():
                self._writer.add_scalar(f"{event.stage}/{name}", value, event.step)

    def close(self) -> None:
        """Flush and close."""
        with write_guard(self._folder):
            self._writer.close()


def _scalars(event: Event) -> dict[str, float]:
    """Return the curves that an event adds a point to."""
    if isinstance(event, StepReport):
        curves = {"loss": event.loss, "points": float(event.points)}
        curves |= {f"loss/{name}": value for name, value in event.losses.items()}
        curves |= {f"rate/{name}": value for name, value in event.rates.items()}
        return curves if event.psnr is None else {**curves, "psnr": event.psnr}
    if isinstance(event, ValidationReport):
        curves = {"validation/psnr": event.psnr}
        return curves | {f"validation/{name}": value for name, value in event.scores.items()}
    if isinstance(event, PopulationReport):
        return {"pruned": float(event.pruned), "grown": float(event.grown)}
    return {}


def _finite(value: Any) -> Any:
    """Replace NaN and infinity, which JSON does not know, by None."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _cut(path: Path, resumed: tuple[str, int] | None) -> None:
    """Cut a log at the first torn line and at the first line after the resumed step."""
    keep = 0
    with path.open("rb") as file:
        for line in file:
            if not line.endswith(b"\n") or _is_later(line, resumed):
                break
            keep += len(line)
    if keep < path.stat().st_size:
        with path.open("rb+") as file:
            file.truncate(keep)


def _is_later(line: bytes, resumed: tuple[str, int] | None) -> bool:
    try:
        record = json.loads(line)
        stage, step = record["stage"], record["step"]
    except (ValueError, KeyError, TypeError):
        return True  # A torn line in the middle: what follows cannot be trusted either.
    return resumed is not None and stage == resumed[0] and step > resumed[1]
