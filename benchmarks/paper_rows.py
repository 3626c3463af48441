"""Rows of the paper's tables: means of ours, and below them what it prints, marked as quoted."""

from __future__ import annotations

import csv
import io
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.paper_figures import COLUMNS, NBS_QUOTED, Row, Table

ROW_HEADS = ("data", "method", "quoted", "psnr", "ssim", "lpips_alex", "primitives")
_NBS = ("psnr", "ssim", "lpips_alex", "chamfer", "emd", "f_01", "f_02")


def ours(records: Sequence[Mapping[str, Any]], kinds: Sequence[str]) -> list[Row]:
    """Means of every method over objects and states of some kinds; None where one is missing."""
    found: dict[str, list[tuple[list[float | None], int | None]]] = {}
    for record in records:
        states = [s for s, kind in record["about"]["kinds"].items() if kind in kinds]
        for line in record["methods"]:
            name = f"{line['name']} ({line['setting']})"
            for state in states:
                cells = line["cells"].get(state, {})
                figures = [cells.get(one, {}).get("value") for one in COLUMNS]
                found.setdefault(name, []).append((figures, line["cost"]["primitives"]))
    rows: list[Row] = []
    for name, values in found.items():
        columns = list(zip(*(figures for figures, _ in values), strict=True))
        counts = [count for _, count in values if count is not None]
        size = f"{statistics.mean(counts):,.0f}" if counts else None
        rows.append((name, (*map(_mean, columns), size)))
    return rows


def text_of(table: Table, rows: Mapping[str, Sequence[Row]], scenes: Sequence[str]) -> str:
    """The table for documents: for each data set ours, then the paper's."""
    lines = [
        f"**{table.title}**: {', '.join(scenes) or 'no scene'}; whole images, protocol standard",
        "",
        "| data | method | PSNR | SSIM | LPIPS (AlexNet) | primitives |",
        "|---|---|---|---|---|---|",
        *(
            f"| {data} | {name} {_cells(values)}"
            for data, own in rows.items()
            for name, values in own
        ),
    ]
    for data, quoted in table.quoted.items():
        lines += [f"| {data} | {name} - QUOTED {_cells(values)}" for name, values in quoted]
    return "\n".join(lines)


def table_csv(table: Table, rows: Mapping[str, Sequence[Row]]) -> bytes:
    """The same for programs, with all digits."""
    lines: list[Sequence[Any]] = [
        (data, name, "no", *values) for data, own in rows.items() for name, values in own
    ]
    for data, quoted in table.quoted.items():
        lines += [(data, name, "yes", *_four(values)) for name, values in quoted]
    return _written(ROW_HEADS, lines)


def nbs_parts(rows: Sequence[Mapping[str, Any]]) -> tuple[str, bytes, list[dict[str, Any]]]:
    """Table, CSV and lines for every picture of what `benchmarks.skinning` wrote as JSON."""
    lines: list[Sequence[Any]] = []
    for kind, tuned in (("PAPR", False), ("P-CORE", True)):
        chosen = [row for row in rows if row["run"].endswith("-pcore") is tuned]
        for method in dict.fromkeys(row["method"] for row in chosen):
            own = [row["scores"] for row in chosen if row["method"] == method]
            means = [_mean([one.get(name) for one in own]) for name in _NBS]
            lines.append(("at hand", f"{method}, renderer of {kind}", "no", *means))
    lines += [("six of Objaverse", name, "yes", *values) for name, values in NBS_QUOTED]
    text = [
        "**skinning weights**: means over the true motions; whole images, protocol standard",
        "",
        "| data | weights | PSNR | SSIM | LPIPS | CD | EMD | F 0.01 | F 0.02 |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for data, name, quoted, *values in lines:
        shown = ["-" if v is None else f"{v:.{2 if n == 0 else 3}f}" for n, v in enumerate(values)]
        text.append(f"| {data} | {name}{' - QUOTED' * (quoted == 'yes')} | {' | '.join(shown)} |")
    pictures = [
        {"run": row["run"], "state": row["state"], "method": row["method"], "view": view, **scores}
        for row in rows
        for view, scores in row["images"].items()
    ]
    return "\n".join(text), _written(("data", "weights", "quoted", *_NBS), lines), pictures


def _cells(values: Sequence[float | str | None]) -> str:
    *figures, size = _four(values)
    digits = (2, 3, 3)
    texts = ["-" if v is None else f"{v:.{d}f}" for v, d in zip(figures, digits, strict=True)]
    return f"| {' | '.join([*texts, str(size or '-')])} |"


def _four(values: Sequence[Any]) -> tuple[Any, ...]:
    return (*values, None)[:4]


def _mean(values: Sequence[float | None]) -> float | None:
    known = [float(value) for value in values if value is not None]
    return statistics.mean(known) if known and len(known) == len(values) else None


def _written(heads: Sequence[str], lines: Sequence[Sequence[Any]]) -> bytes:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    writer.writerows([("" if v is None else v for v in line) for line in lines])
    return text.getvalue().encode()
