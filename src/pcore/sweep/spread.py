"""Means and spreads over seeds, and paired differences between the variants of a sweep."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from scipy.stats import t as student

from pcore.sweep.sweep_plan import ALL
from pcore.sweep.sweep_scores import Score

_CONFIDENCE = 0.95
Variant = tuple[str, str]
"""Setting and method."""
_Place = tuple[str, str]
"""State and protocol."""
_Table = dict[tuple[str, int], Mapping[str, float]]
"""(scene, seed) -> metric -> value, of one variant in one place."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """A figure over seeds, or over pairs.

    Attributes:
        mean: of the values.
        spread: their standard deviation (n - 1); None for fewer than two.
        count: how many there are.
    """

    mean: float
    spread: float | None
    count: int

    def interval(self) -> tuple[float, float] | None:
        """Interval of 95 % of the true mean by Student's t; None for fewer than two values."""
        if self.spread is None:
            return None
        reach = float(student.ppf((1 + _CONFIDENCE) / 2, self.count - 1))
        half = reach * self.spread / math.sqrt(self.count)
        return self.mean - half, self.mean + half


@dataclass(frozen=True, kw_only=True)
class VariantMean:
    """A variant in one state of a scene, or of all scenes together (`ALL`): over seeds."""

    setting: str
    method: str
    scene: str
    state: str
    protocol: str
    figures: Mapping[str, Spread]


@dataclass(frozen=True, kw_only=True)
class PairedDifference:
    """A variant minus the one it is compared with, over pairs of the same scene and seed."""

    setting: str
    method: str
    against: Variant
    state: str
    protocol: str
    figures: Mapping[str, Spread]


def variant_means(scores: Sequence[Score]) -> list[VariantMean]:
    """Sum up over seeds: each scene, then the mean over scenes where there are several.

    The mean over scenes takes the seeds that every scene has.
    """
    scenes_of: dict[_Place, set[str]] = {}
    for one in scores:
        scenes_of.setdefault((one.state, one.protocol), set()).add(one.scene)
    found: list[VariantMean] = []
    for (setting, method), places in _tables(scores).items():
        for (state, protocol), table in places.items():
            scenes = dict.fromkeys(scene for scene, _ in table)
            groups = {name: _of_scene(table, name) for name in scenes}
            # A mean over fewer scenes than the other variants' would compare unlike things.
            if len(scenes_of[state, protocol]) == len(scenes) > 1:
                groups[ALL] = _over_scenes(groups)
            found += [
                VariantMean(
                    setting=setting,
                    method=method,
                    scene=scene,
                    state=state,
                    protocol=protocol,
                    figures=_figures([*members.values()]),
                )
                for scene, members in groups.items()
                if members
            ]
    return found


def paired_differences(scores: Sequence[Score]) -> list[PairedDifference]:
    """Compare every variant with the first setting.

    With the same method there; with its first method where it has no such, and within itself.
    """
    tables = _tables(scores)
    if not tables:
        return []
    first = next(iter(tables))
    found: list[PairedDifference] = []
    for (setting, method), places in tables.items():
        same = (first[0], method)
        against = same if setting != first[0] and same in tables else first
        if (setting, method) == against:
            continue
        for place in [one for one in places if one in tables[against]]:
            figures = _figures(_differences(places[place], tables[against][place]))
            if figures:
                found.append(
                    PairedDifference(
                        setting=setting,
                        method=method,
                        against=against,
                        state=place[0],
                        protocol=place[1],
                        figures=figures,
                    )
                )
    return found


def _tables(scores: Sequence[Score]) -> dict[Variant, dict[_Place, _Table]]:
    found: dict[Variant, dict[_Place, _Table]] = {}
    for one in scores:
        # Infinity, as the PSNR of equal pictures, has no spread and no difference.
        known = {
            name: float(value)
            for name, value in one.scores.items()
            if value is not None and math.isfinite(value)
        }
        places = found.setdefault((one.setting, one.method), {})
        places.setdefault((one.state, one.protocol), {})[one.scene, one.seed] = known
    return found


def _of_scene(table: _Table, scene: str) -> dict[int, Mapping[str, float]]:
    return {seed: values for (name, seed), values in table.items() if name == scene}


def _over_scenes(
    groups: Mapping[str, Mapping[int, Mapping[str, float]]],
) -> dict[int, Mapping[str, float]]:
    """Mean over scenes for each seed, of what all scenes have."""
    members = [*groups.values()]
    seeds = [seed for seed in members[0] if all(seed in one for one in members)]
    return {
        seed: {
            name: statistics.fmean(one[seed][name] for one in members)
            for name in members[0][seed]
            if all(name in one[seed] for one in members)
        }
        for seed in seeds
    }


def _differences(values: _Table, others: _Table) -> list[dict[str, float]]:
    return [
        {name: mine[name] - others[key][name] for name in mine if name in others[key]}
        for key, mine in values.items()
        if key in others
    ]


def _figures(members: Sequence[Mapping[str, float]]) -> dict[str, Spread]:
    names = dict.fromkeys(name for one in members for name in one)
    return {name: _spread([one[name] for one in members if name in one]) for name in names}


def _spread(values: Sequence[float]) -> Spread:
    spread = statistics.stdev(values) if len(values) > 1 else None
    return Spread(mean=statistics.fmean(values), spread=spread, count=len(values))
