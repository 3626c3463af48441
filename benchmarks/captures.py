"""Captures beside their bars: photos of real tools in, edited objects and files out.

DATA holds `captures/{fox,beer,dtu_scan24}`, `nerf_synthetic/{lego,chair}` and `deformed/spot`. Rows
that train take the minutes that their bar allows, by the clock. Every row leaves OUT/ROW.json; the
same command goes on where it was stopped, and a row whose file is there is not made again. Writes
OUT/captures.md; the exit status is 1 where a bar is missed, or a row could not be measured.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import torch

from benchmarks.capture_figures import Figure, Place, processor_seconds
from benchmarks.capture_rows import ROWS
from benchmarks.measure import machine
from pcore.errors import PcoreError
from pcore.files.atomic import write_atomically

HEADS = ("row", "figure", "bar", "value", "kept", "seconds of the row", "processor s")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="+", choices=[*ROWS], default=[*ROWS], metavar="ROW")
    parser.add_argument("--threads", type=int, help="of the CPU; default: all cores")


def run(wish: argparse.Namespace) -> int:
    """Measure the rows that are not there yet, print and write the table."""
    if wish.threads is not None:
        torch.set_num_threads(wish.threads)
    wish.out.mkdir(parents=True, exist_ok=True)
    failed = list[str]()
    for name in wish.only:
        path = wish.out / f"{name}.json"
        if not path.is_file():
            try:
                record = measured(name, Place(wish.data, wish.out / name, wish.threads))
            except (PcoreError, OSError) as error:
                failed.append(f"{name}: not measured: {error}")
                print(failed[-1], file=sys.stderr, flush=True)
                continue
            write_atomically(path, json.dumps(record, indent=1).encode())
        print(*lines_of(name, json.loads(path.read_text())), sep="\n", flush=True)
    text, missed = table(wish.out)
    write_atomically(wish.out / "captures.md", text.encode())
    print(f"written to {wish.out / 'captures.md'}; {missed} bars missed, {len(failed)} rows failed")
    return int(bool(missed or failed))


def measured(name: str, place: Place) -> dict[str, object]:
    """Measure a row; seconds are those of this call, also where it went on with a training."""
    clock, processor = time.monotonic(), processor_seconds()
    figures = ROWS[name](place)
    return {
        "figures": [asdict(one) for one in figures],
        "seconds": time.monotonic() - clock,
        "processor_seconds": processor_seconds() - processor,
        "machine": machine(torch.device("cpu"), torch.get_num_threads()),
    }


def lines_of(name: str, record: Mapping[str, object]) -> list[str]:
    """Lines of the table for the record of a row; what the row took stands in the first."""
    lines: list[str] = []
    spent = [f"{record['seconds']:.0f}", f"{record['processor_seconds']:.0f}"]
    for one in figures_of(record):
        kept = "yes" if one.kept else "no"
        cells = [name, one.what, one.bar_text, one.value_text, kept, *spent]
        lines.append(f"| {' | '.join(cells)} |")
        spent = ["", ""]
    return lines


def figures_of(record: Mapping[str, object]) -> Sequence[Figure]:
    """The figures of the record of a row."""
    kept = record["figures"]
    assert isinstance(kept, list), "written by `measured`"
    return [Figure(**one) for one in kept]


def table(out: Path) -> tuple[str, int]:
    """All rows that were measured, also by earlier calls, and how many bars they miss."""
    lines, missed = [f"| {' | '.join(HEADS)} |", "|---" * len(HEADS) + "|"], 0
    for name in ROWS:
        path = out / f"{name}.json"
        if path.is_file():
            record = json.loads(path.read_text())
            lines += lines_of(name, record)
            missed += sum(not one.kept for one in figures_of(record))
    return "\n".join(lines) + "\n", missed
