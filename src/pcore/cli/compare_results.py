"""Results of `pcore compare`: lines while it works, files, tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from pcore.cli.console import say
from pcore.cli.layout import Sheet, room, sheet_lines
from pcore.errors import InputError
from pcore.evaluation.contest import Outcome
from pcore.evaluation.contest_tables import (
    COMPARE_FILE,
    COSTS,
    Line,
    contest_csv,
    contest_record,
    cost_rows,
    images_csv,
    lines_of,
    markdown,
    quality_rows,
)
from pcore.evaluation.runner import mean
from pcore.evaluation.tables import IMAGES_FILE, shown, write_json
from pcore.files.atomic import write_atomically

CSV_FILE, TABLES_FILE = "compare.csv", "compare.md"


def teller(console: Console, total: int) -> Callable[[Outcome], None]:
    """Prints a line for every outcome."""
    done = [0]

    def tell(outcome: Outcome) -> None:
        done[0] += 1
        psnr = mean([row.scores.get("foreground_psnr") for row in outcome.rows])
        said = f"{shown(psnr)} dB" if outcome.failed is None else f"failed: {outcome.failed}"
        seed = f", seed {outcome.seed}" if outcome.seed else ""
        line = (
            f"{done[0]}/{total} {outcome.name} ({outcome.setting}{seed}), {outcome.state}: {said}"
        )
        say(console, line)

    return tell


def finish(
    console: Console,
    output: Path,
    outcomes: Sequence[Outcome],
    states: Sequence[str],
    *,
    about: dict[str, Any],
    notes: Sequence[str],
) -> None:
    """Write the files and print the tables.

    Args:
        console: where to.
        output: folder of the results.
        outcomes: of all methods.
        states: their names, in the order of the columns.
        about: what was compared, for the file.
        notes: what a reader has to know besides failures.
    """
    lines = lines_of(outcomes, "standard")
    failures = [f"{line.name}, {s}: {why}" for line in lines for s, why in line.failed.items()]
    said = [*notes, *failures]
    record = contest_record(lines, about=about, notes=said)
    write_json(output / COMPARE_FILE, {**record, "status": "finished"})
    write_atomically(output / CSV_FILE, contest_csv(lines))
    write_atomically(output / IMAGES_FILE, images_csv(outcomes))
    text = _tables(console, lines, states)
    text += "".join(f"- {line}\n" for line in said)
    write_atomically(output / TABLES_FILE, text.encode())
    for line in said:
        say(console, f"note: {line}")
    say(console, f"written to {output}")
    if all(one.failed is not None for one in outcomes):
        raise InputError(
            f"{output}: expected a method that can be scored, got failures only; mend what the "
            "notes say, then give the same command again"
        )


_SHOWN = (
    ("foreground PSNR, dB", "foreground_psnr", False),
    ("holes", "hole_rate", True),
    ("depth error, of the object's size", "depth_error_relative", True),
    ("spill, of the object's pixels", "spill_to_object", True),
)


def _tables(console: Console, lines: Sequence[Line], states: Sequence[str]) -> str:
    """Print the tables; return them for a document."""
    tables = [(t, (*states,), quality_rows(lines, states, m, percent=p)) for t, m, p in _SHOWN]
    tables.append(("cost", COSTS, cost_rows(lines)))
    text = ""
    for title, heads, rows in tables:
        sheet = Sheet(title=title, keys=("method", "setting"), columns=heads, rows=tuple(rows))
        say(console, *sheet_lines(sheet, room(console)), "")
        text += markdown(title, heads, rows) + "\n"
    return text
