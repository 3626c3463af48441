"""Tables of a comparison: means over views and seeds, spread over seeds, cost, and failures."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, get_args

from pcore.evaluation.contest import Cost, Outcome, Setting
from pcore.evaluation.health import HEALTH
from pcore.evaluation.runner import Value, mean
from pcore.evaluation.tables import csv_of, jsonable, shown
from pcore.metrics.geometry_metrics import GeometryScores
from pcore.metrics.trunks import TrunkName

COMPARE_FILE = "compare.json"
METRICS = (
    *("foreground_psnr", "psnr", "foreground_ssim", "ssim"),
    *(f"lpips_{trunk}" for trunk in get_args(TrunkName)),
    *(name for name in GeometryScores.__dataclass_fields__ if not name.endswith("_pixels")),
    *HEALTH,
)
"""Of which there are means."""
_IMAGE_KEYS = ("method", "setting", "seed", "state", "kind", "protocol", "view")
_SETTINGS: dict[Setting, str] = {
    "given": "as given",
    "primitives": "equal primitives",
    "time": "equal time",
}


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One method in one state: a metric over all seeds.

    Attributes:
        value: mean over views and seeds; None where it is not defined.
        spread: standard deviation over seeds; None for fewer than two.
    """

    value: Value
    spread: float | None


@dataclass(frozen=True, kw_only=True)
class Line:
    """A method in one setting.

    Attributes:
        name: of the method.
        setting: how it was trained.
        seeds: how many trainings.
        cells: state -> metric -> figures, under the first protocol.
        failed: state -> why there are none.
        cost: means over seeds.
        milliseconds: for a picture, mean over states and seeds.
    """

    name: str
    setting: Setting
    seeds: int
    cells: dict[str, dict[str, Cell]]
    failed: dict[str, str]
    cost: Cost
    milliseconds: float | None

    @property
    def title(self) -> str:
        """Setting and seeds, for people."""
        return _SETTINGS[self.setting] + (f", {self.seeds} seeds" if self.seeds > 1 else "")


def lines_of(outcomes: Sequence[Outcome], protocol: str) -> list[Line]:
    """Sum up outcomes by method and setting, in their order."""
    groups: dict[tuple[str, Setting], list[Outcome]] = {}
    for one in outcomes:
        groups.setdefault((one.name, one.setting), []).append(one)
    return [_line(members, protocol) for members in groups.values()]


def _line(members: Sequence[Outcome], protocol: str) -> Line:
    good = [one for one in members if one.failed is None]
    cells: dict[str, dict[str, Cell]] = {}
    for state in dict.fromkeys(one.state for one in good):
        chosen = [one for one in good if one.state == state]
        cells[state] = {metric: _cell(chosen, metric, protocol) for metric in METRICS}
    costs = [one.cost for one in good]
    return Line(
        name=members[0].name,
        setting=members[0].setting,
        seeds=len({one.seed for one in members}),
        cells=cells,
        failed={one.state: one.failed for one in members if one.failed is not None},
        cost=Cost(
            seconds=mean([one.seconds for one in costs]),
            primitives=_whole(mean([one.primitives for one in costs])),
            parameters=_whole(mean([one.parameters for one in costs])),
            megabytes=mean([one.megabytes for one in costs]),
        ),
        milliseconds=mean([one.milliseconds for one in good]),
    )


def _cell(chosen: Sequence[Outcome], metric: str, protocol: str) -> Cell:
    values = [
        mean([row.scores.get(metric) for row in one.rows if row.protocol == protocol])
        for one in chosen
    ]
    known = [value for value in values if value is not None]
    spread = statistics.stdev(known) if len(known) > 1 else None
    return Cell(value=mean(known), spread=spread)


def contest_record(
    lines: Sequence[Line], *, about: dict[str, Any], notes: Sequence[str]
) -> dict[str, Any]:
    """What `compare.json` holds, as JSON values."""
    record = {"about": about, "notes": [*notes], "methods": [asdict(one) for one in lines]}
    return jsonable(record)


def contest_csv(lines: Sequence[Line]) -> bytes:
    """One line per method and state, with all metrics, spreads, cost, and why there are none."""
    spreads = [f"{metric}_spread" for metric in METRICS]
    cost = [*Cost.__dataclass_fields__]
    heads = ["method", "setting", "seeds", "state", *METRICS, *spreads, *cost, "milliseconds"]
    rows: list[list[object]] = []
    for line in lines:
        for state in [*line.cells, *(one for one in line.failed if one not in line.cells)]:
            cells = line.cells.get(state, {})
            figures = [cells[m].value if m in cells else None for m in METRICS]
            figures += [cells[m].spread if m in cells else None for m in METRICS]
            figures += [getattr(line.cost, name) for name in cost] + [line.milliseconds]
            first = [line.name, line.setting, line.seeds, state]
            rows.append([*first, *figures, line.failed.get(state, "")])
    return csv_of([*heads, "failed"], rows)


def images_csv(outcomes: Sequence[Outcome]) -> bytes:
    """One line per picture: method, setting, seed, state, view and all scores."""
    columns = list(dict.fromkeys(k for one in outcomes for row in one.rows for k in row.scores))
    rows: list[list[object]] = []
    for one in outcomes:
        for row in one.rows:
            where = [one.name, one.setting, one.seed, row.state, row.kind, row.protocol, row.view]
            rows.append([*where, *(row.scores.get(name) for name in columns)])
    return csv_of([*_IMAGE_KEYS, *columns], rows)


def quality_rows(
    lines: Sequence[Line],
    states: Sequence[str],
    metric: str,
    digits: int = 2,
    *,
    percent: bool = False,
) -> list[tuple[tuple[str, str], tuple[str, ...]]]:
    """Keys (method, setting) and figures by state of one metric, for people."""
    rows: list[tuple[tuple[str, str], tuple[str, ...]]] = []
    for line in lines:
        texts = [_text(line, state, metric, digits, percent) for state in states]
        rows.append(((line.name, line.title), tuple(texts)))
    return rows


def known(lines: Sequence[Line], metric: str) -> bool:
    """Whether any method has figures of a metric; also where all of them failed."""
    values = [cells[metric].value for line in lines for cells in line.cells.values()]
    return not values or any(value is not None for value in values)


def cost_rows(lines: Sequence[Line]) -> list[tuple[tuple[str, str], tuple[str, ...]]]:
    """Keys (method, setting) and what each cost."""
    return [
        (
            (line.name, line.title),
            (
                _count(line.cost.primitives),
                _count(line.cost.parameters),
                shown(line.cost.seconds, 0),
                shown(line.cost.megabytes, 0),
                shown(line.milliseconds, 0),
            ),
        )
        for line in lines
    ]


COSTS = ("primitives", "parameters", "training\ns", "memory\nMB", "picture\nms")


def markdown(
    title: str, heads: Sequence[str], rows: Sequence[tuple[tuple[str, str], tuple[str, ...]]]
) -> str:
    """A table for documents."""
    names = ["method", "setting", *(head.replace("\n", " ") for head in heads)]
    lines = [f"**{title}**", "", f"| {' | '.join(names)} |", "|---" * len(names) + "|"]
    lines += [f"| {' | '.join([*keys, *values])} |" for keys, values in rows]
    return "\n".join(lines) + "\n"


def _text(line: Line, state: str, metric: str, digits: int, percent: bool) -> str:
    cell = line.cells.get(state, {}).get(metric)
    if cell is None:
        return "failed" if state in line.failed else shown(None)
    text = shown(cell.value, digits, percent=percent)
    if cell.spread is None or percent:
        return text
    return f"{text} ± {cell.spread:.{digits}f}"


def _count(value: int | None) -> str:
    return shown(None) if value is None else f"{value:,}"


def _whole(value: float | None) -> int | None:
    return None if value is None else round(value)
