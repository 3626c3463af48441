"""Compare methods on states: one file per method and state, so that nothing is done twice.

A method that fails is a row that says why, and stops no other.
"""

from __future__ import annotations

import hashlib
import json
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from pcore.errors import PcoreError
from pcore.evaluation.health import Health
from pcore.evaluation.picture_method import folder_of
from pcore.evaluation.protocol import STANDARD, Perceptual, Protocol
from pcore.evaluation.runner import ImageRow, Method, Tells, evaluate
from pcore.evaluation.states import State
from pcore.evaluation.tables import jsonable, numbers_of, write_json
from pcore.geometry.camera import Camera
from pcore.render.image import Image
from pcore.training.ranks import by_itself, current_ranks

Setting = Literal["given", "primitives", "time"]
"""Trained before; with as many primitives as the points of PAPR; for as long as asked for."""

ROWS = "rows"


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What a method takes beside its pictures; None where that is not known.

    Attributes:
        seconds: of the processor, for its training.
        primitives: points, Gaussians or voxels.
        parameters: numbers that were learned.
        megabytes: the most memory that the training took.
    """

    seconds: float | None = None
    primitives: int | None = None
    parameters: int | None = None
    megabytes: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Contestant:
    """A method that is ready, and what it cost.

    Attributes:
        method: draws.
        cost: of its training.
        cost_in: instead of `cost`, where a method learns every state by itself; asked for after
            the pictures.
    """

    method: Method
    cost: Cost = field(default_factory=Cost)
    cost_in: Callable[[State], Cost] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Entry:
    """A method before it is made: trained or opened when the first of its pictures is needed.

    Attributes:
        name: for tables: whose rule, and whose trainer.
        setting: how it was trained.
        seed: of its training.
        stamp: what it depends on, as JSON values; results of another stamp are done again.
        make: trains or opens it.
        learns: whether it trains something by itself; entries of one stamp share their training.
    """

    name: str
    setting: Setting
    seed: int
    stamp: Any
    make: Callable[[], Contestant]
    learns: bool = False


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One method in one state.

    Attributes:
        name: of the method.
        setting: how it was trained.
        seed: of its training.
        state: name of the state.
        rows: one per picture and protocol; empty where it failed.
        cost: of the training.
        milliseconds: of the processor, for a picture.
        failed: why there are no rows; None where there are.
    """

    name: str
    setting: Setting
    seed: int
    state: str
    rows: tuple[ImageRow, ...] = ()
    cost: Cost = field(default_factory=Cost)
    milliseconds: float | None = None
    failed: str | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Contest:
    """What is asked of every method.

    Attributes:
        folder: for the results.
        states: to draw.
        stamp: what all results depend on besides the methods: scene, size, views.
        protocols: how pictures are compared.
        perceptual: LPIPS networks.
    """

    folder: Path
    states: Sequence[State]
    stamp: Any
    protocols: Sequence[Protocol] = (STANDARD,)
    perceptual: Perceptual | None = None

    def run(
        self, entries: Sequence[Entry], tell: Callable[[Outcome], None] = lambda outcome: None
    ) -> list[Outcome]:
        """Score all entries, or read their scores where they are on the disk already.

        Processes that work together take methods in turn, those that share a training as one.

        Args:
            entries: the methods.
            tell: told of what this process has done.

        Returns:
            In the first process all of it, in order; nothing in the others.

        Raises:
            OSError: a result cannot be written.
            KeyboardInterrupt: Ctrl-C; what was done is kept.
        """
        ranks = current_ranks()
        groups: dict[str, list[int]] = {}
        for number, entry in enumerate(entries):
            key = str(jsonable(entry.stamp)) if entry.learns else str(number)
            groups.setdefault(key, []).append(number)
        shares = [[*groups.values()][rank :: ranks.count] for rank in range(ranks.count)]

        def done(rank: int) -> dict[int, list[Outcome]]:
            with by_itself():
                numbers = [number for group in shares[rank] for number in group]
                return {number: self._all_of(entries[number], tell) for number in numbers}

        parts = ranks.in_turn(ranks.count, done)
        found = {number: own for part in parts for number, own in part.items()}
        return [one for number in sorted(found) for one in found[number]]

    def _all_of(self, entry: Entry, tell: Callable[[Outcome], None]) -> list[Outcome]:
        once = _Once(entry)
        outcomes: list[Outcome] = []
        for state in self.states:
            found = self._outcome(entry, once, state)
            outcomes.append(found)
            tell(found)
        return outcomes

    def _outcome(self, entry: Entry, once: _Once, state: State) -> Outcome:
        path = self._path(entry, state)
        stamp = jsonable([self.stamp, entry.stamp, [one.name for one in self.protocols]])
        known = _read(path, stamp)
        if known is not None:
            return known
        found = self._scored(entry, once, state)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, {"stamp": stamp, **asdict(found)})
        return found

    def _scored(self, entry: Entry, once: _Once, state: State) -> Outcome:
        base = Outcome(name=entry.name, setting=entry.setting, seed=entry.seed, state=state.name)
        try:
            made, timed = once.made()
            timed.seconds.clear()
            rows = evaluate([timed], [state], protocols=self.protocols, perceptual=self.perceptual)
            cost = made.cost if made.cost_in is None else made.cost_in(state)
        except PcoreError as error:
            return replace(base, failed=str(error))
        except Exception as error:
            # Whatever packages and files of others raise: one failing method stops no other, and
            # its row says why. Ctrl-C is no Exception.
            return replace(base, failed=f"{type(error).__name__}: {error}")
        spent = 1000 * statistics.median(timed.seconds)
        return replace(base, rows=tuple(rows), cost=cost, milliseconds=spent)

    def _path(self, entry: Entry, state: State) -> Path:
        # Letters for people; the rest tells names apart that differ in others, or in capitals.
        letters = "".join(c if c.isalnum() or c in "+-" else "_" for c in entry.name)
        apart = hashlib.sha256(entry.name.encode()).hexdigest()[:8]
        place = f"{letters}-{apart}-{entry.setting}-{entry.seed}"
        return self.folder / ROWS / place / f"{folder_of(state.name)}.json"


class _Once:
    """Makes a method when it is first asked for, and fails the same way afterwards."""

    def __init__(self, entry: Entry) -> None:
        self._entry = entry
        self._made: tuple[Contestant, _Timed] | None = None
        self._error: Exception | None = None

    def made(self) -> tuple[Contestant, _Timed]:
        if self._error is not None:
            raise self._error
        if self._made is None:
            try:
                made = self._entry.make()
                self._made = made, _Timed(made.method)
            except Exception as error:
                self._error = error
                raise
        return self._made


class _Timed:
    """A method whose pictures are timed."""

    def __init__(self, method: Method) -> None:
        self._method = method
        self._warm = False
        self.seconds: list[float] = []

    @property
    def name(self) -> str:
        return self._method.name

    @property
    def tells(self) -> Tells:
        return self._method.tells

    def pose(self, state: State) -> Any:
        return self._method.pose(state)

    def draw(self, posed: Any, camera: Camera) -> Image:
        if not self._warm:
            # The first picture also waits for kernels to be compiled: it is taken twice.
            self._method.draw(posed, camera)
            self._warm = True
        start = time.process_time()
        found = self._method.draw(posed, camera)
        self.seconds.append(time.process_time() - start)
        return found

    def health(self, posed: Any, state: State) -> Health | None:
        return self._method.health(posed, state)


def _read(path: Path, stamp: Any) -> Outcome | None:
    """A result of an earlier time; None where there is none, of another stamp, or a failure."""
    try:
        record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if record.pop("stamp") != stamp or record["failed"] is not None:
            return None
        record["cost"] = Cost(**record["cost"])
        record["rows"] = tuple(
            _row({**row, "scores": numbers_of(row["scores"])}) for row in record["rows"]
        )
        return Outcome(**record)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _row(values: dict[str, Any]) -> ImageRow:
    return ImageRow(**values)
