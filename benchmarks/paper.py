"""The paper's tables and figures, one command each; its own figures stand below ours, as quoted.

    python -m benchmarks.paper main RUNS NAME ...        # editing: means over the analytic states
    python -m benchmarks.paper realistic RUNS NAME ...   # realistic motions: skeletal states
    python -m benchmarks.paper motion RUNS NAME ...      # beside PAPR-in-Motion: skeletal states
    python -m benchmarks.paper nvs RUNS NAME ...         # novel views before any editing
    python -m benchmarks.paper ablation RUNS NAME        # the figure, by `pcore ablate`
    python -m benchmarks.paper nbs RUNS --data DATA      # skinning weights, by benchmarks.skinning

RUNS holds a run NAME for each object and, where they are there, NAME-pcore and NAME-gaussians. The
first four compare them (`pcore compare`, results in RUNS/NAME/compare; what is done is not done
again) and print means over objects and states. Further options of `pcore compare` may follow `--`.
Objects, resolutions and trainings are not the paper's: quoted figures are no baseline of ours.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcore.evaluation.contest_tables import COMPARE_FILE

Row = tuple[str, tuple[float | str | None, ...]]
COLUMNS = ("psnr", "ssim", "lpips_alex")
_BESIDE = ("", "-pcore", "-gaussians")


@dataclass(frozen=True, kw_only=True)
class Table:
    """One table of the paper.

    Attributes:
        title: what it shows.
        kinds: of the states whose mean is taken.
        quoted: data set -> rows of the paper: method, PSNR, SSIM, LPIPS, and primitives if given.
    """

    title: str
    kinds: tuple[str, ...]
    quoted: Mapping[str, Sequence[Row]]


TABLES = {
    "main": Table(
        title="zero-shot editing",
        kinds=("analytic",),
        quoted={
            "Neural Editor": (
                ("Deforming-NeRF", (14.71, 0.722, 0.197, None)),
                ("Neural Editor", (25.62, 0.939, 0.078, "1M")),
                ("SC-GS", (18.55, 0.832, 0.123, "236K")),
                ("Mani-GS", (20.59, 0.875, 0.116, "1.2M")),
                ("PAPR", (24.22, 0.930, 0.066, "30K")),
                ("P-CORE", (25.31, 0.942, 0.054, "30K")),
            ),
            "Objaverse": (
                ("Deforming-NeRF", (15.89, 0.773, 0.180, None)),
                ("Neural Editor", (28.02, 0.956, 0.048, "1M")),
                ("SC-GS", (25.29, 0.929, 0.057, "228K")),
                ("Mani-GS", (26.04, 0.946, 0.069, "362K")),
                ("PAPR", (23.15, 0.940, 0.058, "30K")),
                ("P-CORE", (28.30, 0.965, 0.039, "30K")),
            ),
        },
    ),
    "realistic": Table(
        title="realistic motions",
        kinds=("skeletal",),
        quoted={
            "Objaverse hand": (
                ("PAPR", (28.55, 0.964, 0.040)),
                ("P-CORE", (29.66, 0.972, 0.028)),
            ),
            "Mixamo running": (
                ("PAPR", (24.40, 0.956, 0.046)),
                ("P-CORE", (29.95, 0.979, 0.021)),
            ),
        },
    ),
    "motion": Table(
        title="beside PAPR-in-Motion, which is trained on the end state",
        kinds=("skeletal",),
        quoted={
            "Objaverse": (
                ("PAPR-in-Motion (geometry)", (26.31, 0.946, 0.044)),
                ("PAPR-in-Motion (geometry + appearance)", (33.46, 0.986, 0.021)),
                ("P-CORE", (28.84, 0.968, 0.030)),
            )
        },
    ),
    "nvs": Table(
        title="novel views before any editing",
        kinds=("canonical",),
        quoted={
            "DTU": (
                ("3DGS", (33.77, 0.965, 0.044)),
                ("2DGS", (33.89, 0.966, 0.048)),
                ("Mani-GS", (31.50, 0.943, 0.088)),
                ("P-CORE", (33.48, 0.973, 0.023)),
            ),
            "Mip-NeRF 360": (
                ("3DGS", (26.54, 0.776, 0.266)),
                ("2DGS", (27.03, 0.805, 0.223)),
                ("P-CORE, half resolution", (28.04, 0.808, 0.183)),
            ),
        },
    ),
}


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


def text_of(table: Table, rows: Sequence[Row], objects: Sequence[str]) -> str:
    """The table for documents; rows of the paper are marked."""
    lines = [
        f"**{table.title}**: {', '.join(objects)}; whole images, protocol standard",
        "",
        "| method | PSNR | SSIM | LPIPS (AlexNet) | primitives |",
        "|---|---|---|---|---|",
        *(_line(name, values) for name, values in rows),
    ]
    for data, quoted in table.quoted.items():
        lines += [_line(f"{name} - QUOTED, {data}", values) for name, values in quoted]
    return "\n".join(lines)


def _line(name: str, values: Sequence[float | str | None]) -> str:
    digits = (2, 3, 3)
    texts = [f"{v:.{d}f}" if isinstance(v, float) else "-" for v, d in zip(values, digits)]  # noqa: B905
    size = values[3] if len(values) > 3 and values[3] is not None else "-"
    return f"| {' | '.join([name, *texts, str(size)])} |"


def _mean(values: Sequence[float | None]) -> float | None:
    known = [float(value) for value in values if value is not None]
    return statistics.mean(known) if known and len(known) == len(values) else None


def _compared(runs: Path, name: str, options: Sequence[str]) -> Mapping[str, Any]:
    beside = [runs / f"{name}{end}" for end in _BESIDE]
    words = [str(path) for path in beside if path.is_dir()]
    if _pcore("compare", *words, *options) != 0:
        raise SystemExit(f"{name}: the comparison failed; see above")
    return json.loads((beside[0] / "compare" / COMPARE_FILE).read_text(encoding="utf-8"))


def _pcore(*words: str) -> int:
    return subprocess.run([sys.executable, "-m", "pcore.cli.main", *words], check=False).returncode


def main() -> None:
    """Print one table, or draw one figure."""
    words, _, options = " ".join(sys.argv[1:]).partition(" -- ")
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", choices=[*TABLES, "ablation", "nbs"])
    parser.add_argument("runs", type=Path)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--data", type=Path, help="folder with deformed/, for nbs")
    wish = parser.parse_args(words.split())
    if wish.table == "ablation":
        raise SystemExit(_pcore("ablate", str(wish.runs / wish.names[0]), *options.split()))
    if wish.table == "nbs":
        from benchmarks import skinning

        sys.argv = ["skinning", str(wish.data), str(wish.runs), *options.split()]
        skinning.main()
        print("QUOTED, six Objaverse scenes: RBF 25.32 dB, 0.945, 0.054; NBS 26.46, 0.952, 0.050")
        print("  (PSNR, SSIM, LPIPS); CD 0.077, 0.077; EMD 0.307, 0.303; F0.01 0.409, 0.438; F0.02")
        print("  0.626, 0.640")
        return
    records = [_compared(wish.runs, name, options.split()) for name in wish.names]
    table = TABLES[wish.table]
    print(text_of(table, ours(records, table.kinds), wish.names))


if __name__ == "__main__":
    main()
