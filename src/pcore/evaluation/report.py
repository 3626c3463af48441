"""A comparison as one HTML page that needs nothing else: pictures and videos lie inside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from pcore.errors import InputError
from pcore.evaluation.summary import Gain, StateMean
from pcore.evaluation.tables import shown
from pcore.packages import package

# Metric, title, digits, shown as percent, whether more is better.
_METRICS = (
    ("foreground_psnr", "PSNR, object", 2, False, True),
    ("psnr", "PSNR, image", 2, False, True),
    ("ssim", "SSIM", 3, False, True),
    ("lpips_alex", "LPIPS", 3, False, False),
    ("hole_rate", "Holes", 1, True, False),
    ("depth_error_relative", "Depth error", 2, True, False),
    ("spill_to_object", "Spill", 1, True, False),
    ("strain_99", "Strain, 99 %", 2, False, False),
    ("hole_score", "Hole score", 1, True, False),
    ("unseen", "Unseen", 1, True, False),
)


@dataclass(frozen=True, kw_only=True)
class Headline:
    """One large figure at the top."""

    value: str
    label: str
    detail: str = ""


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One picture or video; `source` is its address, normally a data URI."""

    source: str
    title: str
    alternative: str = ""
    """Text for people who do not see it."""


@dataclass(frozen=True, kw_only=True)
class Section:
    """A state: its name, what to know about it, and rows of equally many pictures."""

    title: str
    caption: str
    rows: tuple[tuple[Figure, ...], ...]


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A figure of the table."""

    text: str
    better: bool = False
    """Whether it beats that of the other methods in this state."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """A line of the table."""

    state: str
    """Empty when the line above belongs to the same state."""
    method: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True, kw_only=True)
class Table:
    """Means of every state and method."""

    columns: tuple[str, ...]
    lines: tuple[Line, ...]
    caption: str


@dataclass(frozen=True, kw_only=True)
class Command:
    """Something to type next."""

    purpose: str
    text: str


@dataclass(frozen=True, kw_only=True)
class Report:
    """All that the page shows, from top to bottom."""

    title: str
    lead: str
    headlines: tuple[Headline, ...]
    videos: tuple[Figure, ...]
    table: Table
    sections: tuple[Section, ...]
    commands: tuple[Command, ...]
    facts: tuple[tuple[str, str], ...]
    notes: tuple[str, ...] = ()

    @property
    def columns(self) -> int:
        """Pictures side by side: the depth maps, half of a row, stand under the colours."""
        found = (len(row) for section in self.sections for row in section.rows)
        return max(1, next(found, 2) // 2)


def render_report(report: Report) -> str:
    """Fill the page; see `filled_page`."""
    return filled_page("pcore.evaluation", "report.html.j2", report=report)


def filled_page(package: str, template: str, **values: Any) -> str:
    """Fill a template of a package; every text is escaped.

    Raises:
        DependencyError: jinja2 is not installed.
    """
    jinja = require_jinja()
    source = files(package).joinpath("templates", template).read_text(encoding="utf-8")
    environment = jinja.Environment(
        autoescape=True, undefined=jinja.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return str(environment.from_string(source).render(**values))


def require_jinja() -> Any:
    """Return the template engine; call this before long work whose end is a report.

    Raises:
        DependencyError: it is not installed.
    """
    return package("jinja2", extra="report", need="the HTML report needs")


def comparison_table(
    means: Sequence[StateMean], *, protocol: str, names: Mapping[str, str], caption: str
) -> Table:
    """Table of one protocol; metrics that nobody has are left out, the better figure is marked.

    Args:
        means: of all states, methods and protocols.
        protocol: the one to show.
        names: state -> how it is called in the page; other states keep their name.
        caption: below the table.

    Raises:
        InputError: there are no figures of that protocol.
    """
    chosen = [one for one in means if one.protocol == protocol]
    if not chosen:
        raise InputError(f"report: expected figures of the protocol {protocol!r}, got none")
    columns = [m for m in _METRICS if any(one.scores.get(m[0]) is not None for one in chosen)]
    lines: list[Line] = []
    for state in dict.fromkeys(one.state for one in chosen):
        group = [one for one in chosen if one.state == state]
        for i, one in enumerate(group):
            cells = tuple(_cell(one, group, column) for column in columns)
            name = names.get(state, state) if i == 0 else ""
            lines.append(Line(state=name, method=one.method, cells=cells))
    return Table(columns=tuple(c[1] for c in columns), lines=tuple(lines), caption=caption)


def headlines(gain: Gain) -> tuple[Headline, ...]:
    """The three figures of a comparison: PSNR recovered, holes closed, canonical quality."""
    return (
        Headline(
            value=shown(gain.recovered, 0, percent=True),
            label=f"of the lost quality recovered by {gain.method}",
            detail=(
                f"Deformation costs {gain.baseline} {shown(gain.lost)} dB of the object's PSNR; "
                f"{gain.method} is {shown(gain.gain)} dB above it (mean of "
                f"{len(gain.states)} states)."
            ),
        ),
        Headline(
            value=shown(gain.holes_removed, 0, percent=True),
            label=f"of the additional holes closed by {gain.method}",
            detail=(
                f"Deformation adds {shown(gain.baseline_holes, 1, percent=True)} of the object to "
                f"the holes of {gain.baseline}, {shown(gain.method_holes, 1, percent=True)} to "
                f"those of {gain.method}; below zero they shrink."
            ),
        ),
        Headline(
            value=f"{shown(gain.canonical_loss)} dB",
            label=f"paid on the undeformed object by {gain.method}",
            detail=(
                f"PSNR of the object that {gain.method} loses on canonical test views; below "
                "zero it gains."
            ),
        ),
    )


def _cell(
    one: StateMean, group: Sequence[StateMean], column: tuple[str, str, int, bool, bool]
) -> Cell:
    key, _, digits, percent, more_is_better = column
    value = one.scores.get(key)
    text = shown(value, digits, percent=percent)
    others = [o.scores.get(key) for o in group if o is not one]
    # What looks equal is equal: no winner by digits that nobody sees.
    rivals = [o for o in others if o is not None and shown(o, digits, percent=percent) != text]
    if value is None or not rivals or len(rivals) < len(others):
        return Cell(text=text)
    wins = all((value > o) == more_is_better for o in rivals)
    return Cell(text=text, better=wins)
