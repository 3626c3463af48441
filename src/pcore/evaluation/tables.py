"""Rows and summaries as files: CSV per picture, JSON per state, written whole or not at all."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

from pcore.errors import InputError
from pcore.evaluation.protocol import PROTOCOLS, Perceptual
from pcore.evaluation.runner import ImageRow, Value
from pcore.evaluation.summary import Gain, StateMean
from pcore.files.atomic import write_atomically

IMAGES_FILE = "images.csv"
SUMMARY_FILE = "summary.json"
_KEYS = ("method", "state", "kind", "protocol", "view")


def csv_bytes(rows: Sequence[ImageRow]) -> bytes:
    """One line per picture and protocol; an empty field is a figure that is not defined.

    Infinity is written as `inf`; numbers have all their digits.
    """
    columns = list(dict.fromkeys(name for row in rows for name in row.scores))
    lines = [
        [getattr(row, key) for key in _KEYS] + [row.scores.get(name) for name in columns]
        for row in rows
    ]
    return csv_of([*_KEYS, *columns], lines)


def csv_of(heads: Sequence[str], lines: Sequence[Sequence[object]]) -> bytes:
    """A table as a CSV file; None and NaN are empty fields, numbers have all their digits."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    for line in lines:
        unknown = [isinstance(value, float) and math.isnan(value) for value in line]
        writer.writerow([None if no else value for value, no in zip(line, unknown, strict=True)])
    return text.getvalue().encode()


def summary_record(
    means: Sequence[StateMean],
    gains: Sequence[Gain],
    *,
    about: Mapping[str, Any],
    perceptual: Perceptual | None = None,
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """Build what `summary.json` holds, as JSON values.

    Args:
        means: means over views.
        gains: comparisons with the baseline; empty when there is one method.
        about: where the figures come from: scene, runs, factor, version.
        perceptual: says why LPIPS columns are empty.
        notes: what else a reader has to know.

    Returns:
        Keys `about`, `protocols` (name -> description), `notes`, `means`, `gains`. Infinity is
        the string "inf" or "-inf", because JSON has no such number; what is not known is null.
    """
    used = dict.fromkeys(one.protocol for one in means)
    note = perceptual.note() if perceptual is not None else None
    record = {
        "about": dict(about),
        "protocols": {n: PROTOCOLS[n].description for n in used if n in PROTOCOLS},
        "notes": [*([note] if note else []), *notes],
        "means": [asdict(one) for one in means],
        "gains": [asdict(one) for one in gains],
    }
    return cast("dict[str, Any]", jsonable(record))


def write_tables(folder: Path, rows: Sequence[ImageRow], record: Mapping[str, Any]) -> None:
    """Write `images.csv` and `summary.json` into `folder`, which is made with its parents.

    Raises:
        OSError: the folder or a file cannot be written; old files are then as they were.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / IMAGES_FILE, csv_bytes(rows))
    write_json(folder / SUMMARY_FILE, record)


def write_json(path: Path, record: Mapping[str, Any]) -> None:
    """Write JSON values atomically; numbers that JSON does not know become strings or null."""
    text = json.dumps(jsonable(record), indent=2, allow_nan=False) + "\n"
    write_atomically(path, text.encode())


def jsonable(value: Any) -> Any:
    """Replace infinities by "inf" and "-inf" and NaN by null, at any depth."""
    if isinstance(value, Mapping):
        items = cast("Mapping[Any, Any]", value)
        return {str(key): jsonable(one) for key, one in items.items()}
    if isinstance(value, (list, tuple)):
        return [jsonable(one) for one in cast("Sequence[Any]", value)]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return value


def read_summary(path: Path) -> tuple[list[StateMean], list[Gain]]:
    """Read means and gains of a `summary.json` back.

    Raises:
        InputError: the file is missing, damaged or not a summary of ours.
    """
    try:
        record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        means = [_mean(one) for one in record["means"]]
        gains = [_gain(one) for one in record["gains"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: expected a summary that `pcore eval` wrote, got something else; "
            "evaluate again"
        ) from error
    return means, gains


def shown(value: Value, digits: int = 2, *, percent: bool = False) -> str:
    """A figure for people: a dash when it is not known, a true minus sign, no "-0.00"."""
    if value is None or math.isnan(value):
        return "–"  # noqa: RUF001 - an en dash is what a table shows for nothing
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"  # noqa: RUF001
    text = f"{value * 100 if percent else value:.{digits}f}"
    if float(text) == 0:
        text = text.removeprefix("-")
    return text.replace("-", "−") + (" %" if percent else "")  # noqa: RUF001


def _mean(record: dict[str, Any]) -> StateMean:
    entries: dict[str, Any] = {**record, "scores": numbers_of(record["scores"])}
    return StateMean(**entries)


def _gain(record: dict[str, Any]) -> Gain:
    entries: dict[str, Any] = {**numbers_of(record), "states": tuple(record["states"])}
    return Gain(**entries)


def numbers_of(record: Mapping[str, Any]) -> dict[str, Any]:
    """Undo how infinity is written in JSON."""
    return {k: float(v) if v in ("inf", "-inf") else v for k, v in record.items()}
