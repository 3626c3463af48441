"""Tables in terminals of any width: fewer columns or blocks where there is no room, nothing cut.

What is piped to a file or another program has no width: it gets every column in one table.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby

from rich.cells import cell_len
from rich.console import Console

_GAP = 2
_MANY, _FEW = 4, 2
"""So many figures stand beside the keys of a row at least: beside all, or without the first."""
_LEAST = 24
"""Letters beside a name under which its value begins on a line of its own."""

Column = tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """A table of figures.

    Attributes:
        title: what it is about.
        keys: headings of the columns that say what a row is about.
        columns: headings of the figures, each of one or two lines.
        rows: for each row its keys and its figures.
    """

    title: str
    keys: Column
    columns: Column
    rows: tuple[tuple[Column, Column], ...]


def room(console: Console) -> int | None:
    """Columns of a terminal; None without one, where nothing needs to be made to fit."""
    return console.width if console.is_terminal else None


def sheet_lines(sheet: Sheet, width: int | None) -> list[str]:
    """Set a table so that it fits.

    As one where there is room; else as several of fewer columns; else as such tables for each
    value of the first key; else as a list of figures for each row.

    Args:
        sheet: the table.
        width: of the terminal in letters; None for one table however wide.
    """
    groups = _groups(sheet, width, _MANY)
    if groups is not None:
        return [sheet.title, *_tables(sheet, groups)]
    lines = [sheet.title]
    for first, rows in groupby(sheet.rows, key=lambda row: row[0][0]):
        rest = tuple((keys[1:], values) for keys, values in rows)
        part = replace(sheet, keys=sheet.keys[1:], rows=rest)
        groups = _groups(part, width, _FEW)
        lines += ["", first, *(_list(part) if groups is None else _tables(part, groups))]
    return lines


def pair_lines(rows: Sequence[tuple[str, str]], width: int | None) -> list[str]:
    """Set names and values in two columns; long values go on below, broken at spaces only."""
    first = max((cell_len(name) for name, _ in rows), default=0) + _GAP
    if width is None:
        return [f"{name}{' ' * (first - cell_len(name))}{value}".rstrip() for name, value in rows]
    lines: list[str] = []
    for name, value in rows:
        beside = width - first >= _LEAST or cell_len(name) + _GAP + cell_len(value) <= width
        indent = " " * (first if width - first >= _LEAST else _GAP)
        parts = _wrapped(value, width - len(indent))
        if not beside:
            lines += [name, *(indent + part for part in parts)]
            continue
        start = name + " " * max(_GAP, len(indent) - cell_len(name))
        lines += [(start + parts[0]).rstrip(), *(indent + part for part in parts[1:])]
    return lines


def _groups(sheet: Sheet, width: int | None, least: int) -> list[list[int]] | None:
    """Figures that stand beside one another; None where there is no room for the `least`."""
    everything = list(range(len(sheet.columns)))
    keys = sum(_key_width(sheet, k) + _GAP for k in range(len(sheet.keys)))
    needed = [_width(sheet, k) + _GAP for k in everything]
    if width is None or keys + sum(needed) - _GAP <= width:
        return [everything]
    if keys + sum(sorted(needed)[-least:]) - _GAP > width:
        return None
    groups: list[list[int]] = [[]]
    used = keys
    for k in everything:
        if groups[-1] and used + needed[k] - _GAP > width:
            groups.append([])
            used = keys
        groups[-1].append(k)
        used += needed[k]
    return groups


def _tables(sheet: Sheet, groups: Sequence[Sequence[int]]) -> list[str]:
    lines: list[str] = []
    for number, group in enumerate(groups):
        lines += [""] * (number > 0) + _table(sheet, group)
    return lines


def _table(sheet: Sheet, group: Sequence[int]) -> list[str]:
    """Headings and rows with the figures of a group; repeated first keys are left out."""
    widths = [_key_width(sheet, k) for k in range(len(sheet.keys))]
    figures = [_width(sheet, k) for k in group]
    lines: list[str] = []
    for level in range(2):
        names = [_two(name)[level] for name in sheet.keys]
        heads = [_two(sheet.columns[k])[level] for k in group]
        lines.append(_line(names, widths, heads, figures))
    lines = [line for line in lines if line]
    before = ""
    for keys, values in sheet.rows:
        told = ["" if keys[:1] == (before,) else keys[0], *keys[1:]] if keys else []
        lines.append(_line(told, widths, [values[k] for k in group], figures))
        before = keys[0] if keys else ""
    return lines


def _line(
    names: Sequence[str], widths: Sequence[int], values: Sequence[str], figures: Sequence[int]
) -> str:
    left = [name + " " * (size - cell_len(name)) for name, size in zip(names, widths, strict=True)]
    right = [" " * (size - cell_len(one)) + one for one, size in zip(values, figures, strict=True)]
    return (" " * _GAP).join([*left, *right]).rstrip()


def _list(sheet: Sheet) -> list[str]:
    """A line for each figure, below the keys of its row."""
    heads = [" ".join(one.replace("-\n", "-").split()) for one in sheet.columns]
    first = max(map(cell_len, heads), default=0)
    lines: list[str] = []
    for keys, values in sheet.rows:
        lines += [f" {key}" for key in keys]
        size = max(map(cell_len, values), default=0)
        lines += [
            _line([f"  {h}"], [first + 2], [v], [size]) for h, v in zip(heads, values, strict=True)
        ]
    return lines


def _two(heading: str) -> tuple[str, str]:
    """The two lines of a heading; one line stands below."""
    above, _, below = heading.rpartition("\n")
    return above, below


def _key_width(sheet: Sheet, k: int) -> int:
    return max([cell_len(sheet.keys[k]), *(cell_len(keys[k]) for keys, _ in sheet.rows)])


def _width(sheet: Sheet, k: int) -> int:
    heads = [cell_len(part) for part in _two(sheet.columns[k])]
    return max([*heads, *(cell_len(values[k]) for _, values in sheet.rows)])


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, max(1, width), break_long_words=False, break_on_hyphens=False) or [
        ""
    ]
