"""Results of `pcore compare`: lines while it works, files, tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.evaluation.contest import Outcome
    from pcore.evaluation.contest_tables import Line

CSV_FILE, TABLES_FILE = "compare.csv", "compare.md"


def teller(console: Console, total: int) -> Callable[[Outcome], None]:
    """Prints a line for every outcome."""
    from pcore.evaluation.runner import mean
    from pcore.evaluation.tables import shown

    done = [0]

    def tell(outcome: Outcome) -> None:
        done[0] += 1
        psnr = mean([row.scores.get("foreground_psnr") for row in outcome.rows])
        said = f"{shown(psnr)} dB" if outcome.failed is None else f"failed: {outcome.failed}"
        seed = f", seed {outcome.seed}" if outcome.seed else ""
        line = (
            f"{done[0]}/{total} {outcome.name} ({outcome.setting}{seed}), {outcome.state}: {said}"
        )
        console.print(Text(line), soft_wrap=True)

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

    Raises:
        InputError: all of them failed; the files are written.
        OSError: a file cannot be written.
    """
    from pcore.evaluation.contest_tables import (
        COMPARE_FILE,
        contest_csv,
        contest_record,
        images_csv,
        lines_of,
    )
    from pcore.evaluation.tables import IMAGES_FILE, write_json
    from pcore.files.atomic import write_atomically

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
        console.print(Text(f"note: {line}"), soft_wrap=True)
    console.print(Text(f"written to {output}"), soft_wrap=True)
    if all(one.failed is not None for one in outcomes):
        raise InputError(
            f"{output}: expected a method that can be scored, got failures only; mend what the "
            "notes say, then give the same command again"
        )


_SHOWN = (
    ("foreground PSNR, dB", "foreground_psnr", 2, False),
    ("PSNR of whole images, dB", "psnr", 2, False),
    ("SSIM", "ssim", 3, False),
    ("LPIPS of AlexNet", "lpips_alex", 3, False),
    ("holes", "hole_rate", 1, True),
    ("depth error, of the object's size", "depth_error_relative", 1, True),
    ("spill, of the object's pixels", "spill_to_object", 1, True),
)
"""Title, metric, digits, whether in percent."""


def _tables(console: Console, lines: Sequence[Line], states: Sequence[str]) -> str:
    """Print the tables; return them for a document."""
    from pcore.cli.layout import Sheet, print_lines, room, sheet_lines
    from pcore.evaluation.contest_tables import COSTS, cost_rows, known, markdown, quality_rows

    tables: list[tuple[str, tuple[str, ...], Any]] = [
        (title, tuple(states), quality_rows(lines, states, metric, digits, percent=percent))
        for title, metric, digits, percent in _SHOWN
        if known(lines, metric)
    ]
    tables.append(("cost", COSTS, cost_rows(lines)))
    text = ""
    for title, heads, rows in tables:
        sheet = Sheet(title=title, keys=("method", "setting"), columns=heads, rows=tuple(rows))
        print_lines(console, [*sheet_lines(sheet, room(console)), ""])
        text += markdown(title, heads, rows) + "\n"
    return text
