"""How often a method was preferred, with exact intervals, and how far people agree."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from scipy.stats import binomtest

from pcore.study.answers import Answers, Key
from pcore.study.trials import ALL

_CONFIDENCE = 0.95


@dataclass(frozen=True, kw_only=True)
class WinRate:
    """How often the first of two methods was chosen.

    Attributes:
        first: its name.
        second: the other's.
        group: of the items; `ALL` for every one.
        wins: choices of the first.
        choices: all choices.
        low: lower end of the exact (Clopper-Pearson) interval of 95 %.
        high: its upper end.
        p: two-sided exact binomial test of "both are chosen equally often".
    """

    first: str
    second: str
    group: str
    wins: int
    choices: int
    low: float
    high: float
    p: float

    @property
    def rate(self) -> float:
        """Share of the choices."""
        return self.wins / self.choices


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """How far people agree on pairs that at least two of them saw.

    Attributes:
        pairs: number of such pairs of pictures.
        observed: share of pairs of people that chose alike, mean over the pairs of pictures.
        kappa: what is above chance of that, of all that could be (Fleiss, with the rates at which
            both methods were chosen); None where everybody chose alike everywhere.
    """

    pairs: int
    observed: float
    kappa: float | None


def win_rates(people: Sequence[Answers], key: Key) -> list[WinRate]:
    """Win rates per pairing: every group of items, then all; pairings in the study's order.

    Two methods that were compared in several pairings appear in each.
    """
    counts: dict[tuple[str, str], dict[str, list[bool]]] = {}
    for trial in key.trials:
        if not trial.catch:
            groups = counts.setdefault((trial.first, trial.second), {})
            groups.setdefault(trial.group, [])
    for first, second, group, won in _choices(people, key):
        counts[first, second][group].append(won)
    found: list[WinRate] = []
    for (first, second), groups in counts.items():
        named = {name: chosen for name, chosen in groups.items() if name}
        everything = [won for chosen in groups.values() for won in chosen]
        for name, chosen in (*named.items(), (ALL, everything)):
            if chosen:
                found.append(_rate(first, second, name, chosen))
    return found


def agreement(people: Sequence[Answers], key: Key) -> Agreement | None:
    """How far people agree; None where no pair was seen by two of them."""
    votes: dict[int, list[bool]] = {}
    for person in people:
        for one in person.answers:
            trial = key.trials[one.trial]
            if not trial.catch:
                votes.setdefault(one.trial, []).append(one.chosen == trial.keys[0])
    shared = [one for one in votes.values() if len(one) > 1]
    if not shared:
        return None
    observed = sum(_alike(one) for one in shared) / len(shared)
    chosen = [won for one in shared for won in one]
    rate = sum(chosen) / len(chosen)
    chance = rate**2 + (1 - rate) ** 2
    return Agreement(
        pairs=len(shared),
        observed=observed,
        kappa=None if chance == 1 else (observed - chance) / (1 - chance),
    )


def _choices(people: Sequence[Answers], key: Key) -> Iterable[tuple[str, str, str, bool]]:
    for person in people:
        for one in person.answers:
            trial = key.trials[one.trial]
            if not trial.catch:
                yield trial.first, trial.second, trial.group, one.chosen == trial.keys[0]


def _rate(first: str, second: str, group: str, chosen: Sequence[bool]) -> WinRate:
    test = binomtest(sum(chosen), len(chosen))
    interval = test.proportion_ci(confidence_level=_CONFIDENCE, method="exact")
    return WinRate(
        first=first,
        second=second,
        group=group,
        wins=sum(chosen),
        choices=len(chosen),
        low=float(interval.low),
        high=float(interval.high),
        p=float(test.pvalue),
    )


def _alike(votes: Sequence[bool]) -> float:
    """Share of pairs of people that chose alike."""
    n, wins = len(votes), sum(votes)
    return (wins * (wins - 1) + (n - wins) * (n - wins - 1)) / (n * (n - 1))
