"""Means over views, and what one method gains over another. Formulas: docs/concepts/metrics.md."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from pcore.evaluation.runner import ImageRow, Value, mean
from pcore.evaluation.states import CANONICAL, Kind

Group = Literal["analytic", "skeletal", "edited"]
GROUPS: tuple[Group, ...] = ("analytic", "skeletal", "edited")


@dataclass(frozen=True, kw_only=True)
class StateMean:
    """Means over the test views of one state.

    Attributes:
        method: name of the method.
        state: name of the state.
        kind: of the state.
        protocol: name of the protocol.
        views: number of test views.
        scores: metric -> mean over the views that have it; None when none has.
    """

    method: str
    state: str
    kind: Kind
    protocol: str
    views: int
    scores: Mapping[str, Value]


@dataclass(frozen=True, kw_only=True)
class Gain:
    """What a method gains over a baseline on one group of states; figures in dB or fractions.

    P is foreground PSNR, H the hole rate, "states" the mean over the group's states, 0 the
    canonical state, m the method and b the baseline. None where a figure is not defined.

    Attributes:
        method: m.
        baseline: b.
        protocol: name of the protocol.
        group: which states.
        states: their names.
        lost: P_b(0) - P_b(states), what the baseline loses by the deformation.
        gain: P_m(states) - P_b(states).
        recovered: gain / lost; None when the baseline loses nothing.
        baseline_holes: H_b(states) - H_b(0).
        method_holes: H_m(states) - H_b(0): against the SAME canonical rate, so that holes in a
            method's own canonical pictures do not count in its favour.
        holes_removed: 1 - method_holes / baseline_holes; None when the baseline has no more.
        canonical_loss: P_b(0) - P_m(0).
        canonical_loss_full: the same of the PSNR over whole images.
    """

    method: str
    baseline: str
    protocol: str
    group: Group
    states: tuple[str, ...]
    lost: float | None
    gain: float | None
    recovered: float | None
    baseline_holes: float | None
    method_holes: float | None
    holes_removed: float | None
    canonical_loss: float | None
    canonical_loss_full: float | None


def state_means(rows: Sequence[ImageRow]) -> list[StateMean]:
    """Mean over views for every method, state and protocol, in the order of the rows."""
    groups: dict[tuple[str, str, str], list[ImageRow]] = {}
    for row in rows:
        groups.setdefault((row.state, row.protocol, row.method), []).append(row)
    return [
        StateMean(
            method=method,
            state=state,
            kind=members[0].kind,
            protocol=protocol,
            views=len(members),
            scores={
                name: mean([row.scores.get(name) for row in members]) for name in members[0].scores
            },
        )
        for (state, protocol, method), members in groups.items()
    ]


def gains(means: Sequence[StateMean], baseline: str) -> list[Gain]:
    """Compare every other method with `baseline`: one entry per protocol, group and method."""
    protocols = dict.fromkeys(one.protocol for one in means)
    methods = [name for name in dict.fromkeys(one.method for one in means) if name != baseline]
    found: list[Gain] = []
    for protocol in protocols:
        table = {(m.method, m.state): m for m in means if m.protocol == protocol}
        for group in GROUPS:
            # An edit is compared where it is scored against true images.
            names = dict.fromkeys(
                m.state
                for m in table.values()
                if m.kind == group and (group != "edited" or m.scores.get("psnr") is not None)
            )
            found += [
                _gain(table, (method, baseline), (protocol, group), tuple(names))
                for method in methods
                if names
            ]
    return found


def _gain(
    table: Mapping[tuple[str, str], StateMean],
    pair: tuple[str, str],
    where: tuple[str, Group],
    states: tuple[str, ...],
) -> Gain:
    method, baseline = pair

    def score(name: str, who: str, which: tuple[str, ...] = (CANONICAL,)) -> float | None:
        values = [table[who, state].scores.get(name) for state in which if (who, state) in table]
        # A mean over fewer states than the other method's would compare unlike things.
        return mean(values) if len(values) == len(which) and None not in values else None

    psnr, holes = "foreground_psnr", "hole_rate"
    lost = minus(score(psnr, baseline), score(psnr, baseline, states))
    gain = minus(score(psnr, method, states), score(psnr, baseline, states))
    before = score(holes, baseline)
    baseline_holes = minus(score(holes, baseline, states), before)
    method_holes = minus(score(holes, method, states), before)
    return Gain(
        method=method,
        baseline=baseline,
        protocol=where[0],
        group=where[1],
        states=states,
        lost=lost,
        gain=gain,
        recovered=_part(gain, lost),
        baseline_holes=baseline_holes,
        method_holes=method_holes,
        holes_removed=minus(1.0, _part(method_holes, baseline_holes)),
        canonical_loss=minus(score(psnr, baseline), score(psnr, method)),
        canonical_loss_full=minus(score("psnr", baseline), score("psnr", method)),
    )


def minus(first: float | None, second: float | None) -> float | None:
    """Difference; None when a side is missing or both are infinite."""
    if first is None or second is None:
        return None
    result = first - second
    return None if math.isnan(result) else result


def _part(part: float | None, whole: float | None) -> float | None:
    """Return part / whole; None when it says nothing: `whole` not positive or not finite."""
    if part is None or whole is None or not (0 < whole < math.inf):
        return None
    return part / whole
