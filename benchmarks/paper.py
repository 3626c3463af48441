"""The paper's six tables and its ablation, one command each, on the data at hand.

    python -m benchmarks.paper main DATA RUNS        # zero-shot editing: means over states
    python -m benchmarks.paper realistic DATA RUNS   # realistic motions: skeletal states
    python -m benchmarks.paper motion DATA RUNS      # beside PAPR-in-Motion, states with photos
    python -m benchmarks.paper nvs DATA RUNS         # novel views before any editing
    python -m benchmarks.paper nbs DATA RUNS         # skinning weights
    python -m benchmarks.paper ablation DATA RUNS    # the figure and its numbers, by `pcore ablate`
    python -m benchmarks.paper study DATA RUNS       # answers of people, by `pcore study read`

DATA holds data sets (docs/guide/published-sets.md says in which folders); what is not there is left
out, with the reason. What has to be trained is trained into RUNS, once; the same command goes on
where an interrupted one stopped. A table is means over scenes and states, for each data set, with
the paper's figures below them, marked as quoted: they are no baseline of ours, as objects,
resolutions and trainings differ. Written are RUNS/paper/TABLE.md, TABLE.csv and TABLE-images.csv
with a line for every picture; `study` prints its table only.

--dry-run says what would be done. Options of `pcore compare` (or `pcore ablate`, or
benchmarks.skinning) may follow `--`.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.commands import run_pcore
from benchmarks.paper_figures import TABLES, Row
from benchmarks.paper_jobs import MODELS, SKINNED, Job, Wish, plan, show
from benchmarks.paper_rows import nbs_parts, ours, table_csv, text_of
from benchmarks.paper_scenes import AT_HAND, Skipped
from pcore.evaluation.contest_tables import COMPARE_FILE
from pcore.evaluation.tables import IMAGES_FILE, SUMMARY_FILE
from pcore.files.atomic import write_atomically

OTHERS = ("ablation", "nbs", "study")


def work(wish: Wish, jobs: Sequence[Job]) -> list[Job]:
    """Do it; a scene that fails is left out, and stops no other."""
    good: list[Job] = []
    for job in jobs:
        for step in job.steps:
            if not step.done and run_pcore(*step.words) != 0:
                reason = f"pcore {step.words[0]} failed; see above"
                wish.skipped.append(Skipped(name=job.scene.run, reason=reason))
                break
        else:
            good.append(job)
    return good


def gather(jobs: Sequence[Job], file: str) -> Mapping[str, list[Any]]:
    """Records of the scored scenes, by data set."""
    found: dict[str, list[Any]] = {}
    for job in jobs:
        record = json.loads((job.folder / file).read_text(encoding="utf-8"))
        found.setdefault(job.scene.data.name, []).append(record)
    return found


def images_csv(jobs: Sequence[Job]) -> bytes:
    """The lines of all scenes for every picture, with data set and scene before them."""
    rows: list[dict[str, str]] = []
    for job in jobs:
        where = {"data": job.scene.data.name, "scene": job.scene.name}
        with (job.folder / IMAGES_FILE).open(newline="", encoding="utf-8") as file:
            rows += [{**where, **row} for row in csv.DictReader(file)]
    return _csv(rows)


def _csv(rows: Sequence[Mapping[str, Any]]) -> bytes:
    text = io.StringIO(newline="")
    heads = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(text, heads, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def finish(wish: Wish, jobs: Sequence[Job]) -> None:
    """Print the table and write its files."""
    notes = [job.scene.note for job in jobs if job.scene.note]
    notes += [f"left out: {one.name}: {one.reason}" for one in wish.skipped]
    scenes = [job.scene.run for job in jobs]
    wish.out.mkdir(parents=True, exist_ok=True)
    if wish.table in TABLES:
        table, rows = TABLES[wish.table], _rows(wish.table, jobs)
        notes += _failures(jobs)
        text, lines = text_of(table, rows, scenes), table_csv(table, rows)
        images = images_csv(jobs)
    elif wish.table == "ablation":
        text, lines = _ablation(gather(jobs, SUMMARY_FILE), scenes)
        images = images_csv(jobs)
    else:
        record = json.loads((wish.out / "nbs.json").read_text(encoding="utf-8"))
        text, lines, pictures = nbs_parts(record)
        images = _csv(pictures)
    text += "".join(f"\n- {one}" for one in notes) + "\n"
    write_atomically(wish.out / f"{wish.table}.md", text.encode())
    write_atomically(wish.out / f"{wish.table}.csv", lines)
    write_atomically(wish.out / f"{wish.table}-images.csv", images)
    print(f"\n{text}\nwritten to {wish.out}")


def _rows(name: str, jobs: Sequence[Job]) -> dict[str, list[Row]]:
    """Our rows by data set; of a published set all deformed states count."""
    kinds = TABLES[name].kinds
    every = kinds if name == "nvs" else ("analytic", "skeletal")
    found = gather(jobs, COMPARE_FILE)
    return {data: ours(own, kinds if data == AT_HAND else every) for data, own in found.items()}


def _failures(jobs: Sequence[Job]) -> list[str]:
    """Methods that failed in a state of a scene, and why."""
    found: list[str] = []
    for job in jobs:
        record = json.loads((job.folder / COMPARE_FILE).read_text(encoding="utf-8"))
        found += [
            f"{job.scene.run}: {line['name']}, {state}: {why}"
            for line in record["methods"]
            for state, why in line["failed"].items()
        ]
    return found


def _ablation(records: Mapping[str, list[Any]], scenes: Sequence[str]) -> tuple[str, bytes]:
    """What the paper shows as pictures, in numbers; it prints none."""
    names = ("foreground_psnr", "psnr", "ssim", "hole_rate", "see_through_rate")
    rows = [
        {"data": data, "method": one["method"], "state": one["state"], **_picked(one, names)}
        for data, own in records.items()
        for record in own
        for one in record["means"]
        if one["protocol"] == "standard"
    ]
    heads = ("data", "method", "state", *names)
    lines = [
        f"**ablation**: {', '.join(scenes)}; protocol standard; the paper shows pictures of Lego, "
        "twice as large, and prints no figures",
        "",
        f"| {' | '.join(heads)} |",
        "|---" * len(heads) + "|",
        *(f"| {' | '.join(_shown(row[head]) for head in heads)} |" for row in rows),
    ]
    return "\n".join(lines), _csv(rows)


def _picked(mean: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    return {name: mean["scores"].get(name) for name in names}


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.3f}" if isinstance(value, float) else str(value)


def _study(wish: Wish) -> int:
    """The table of the user study: what people answered, and the paper's own."""
    folder = wish.runs / "study"
    answers = sorted(folder.glob("answers*.json"))
    if not answers or not (folder / "key.json").is_file():
        print(
            f"left out: the user study: expected {folder}/key.json and answers*.json of people, "
            f"got {len(answers)} answers; `pcore study make` writes the page (docs/guide/study.md)"
        )
        return 0
    return run_pcore("study", "read", str(folder / "key.json"), *map(str, answers))


def _skinning(wish: Wish, jobs: Sequence[Job]) -> bool:
    """Score skinning weights; both objects have to be there."""
    gone = [name for name in SKINNED if name not in {job.scene.name for job in jobs}]
    if gone:
        print(f"left out: nbs: expected {wish.data}/deformed/ of {', '.join(gone)}; not there")
        return False
    wish.out.mkdir(parents=True, exist_ok=True)
    words = [str(wish.data), str(wish.runs), "--json", str(wish.out / "nbs.json"), *wish.options]
    print(f"$ python -m benchmarks.skinning {shlex.join(words)}", flush=True)
    command = [sys.executable, "-m", "benchmarks.skinning", *words]
    return subprocess.run(command, check=False).returncode == 0


def read_wish(words: Sequence[str]) -> tuple[Wish, bool]:
    """What the command line asks for, and whether it is only to be said."""
    own = [*words]
    options: list[str] = []
    if "--" in own:
        own, options = own[: own.index("--")], own[own.index("--") + 1 :]
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", choices=[*TABLES, *OTHERS])
    parser.add_argument("data", type=Path, help="folder of data sets")
    parser.add_argument("runs", type=Path, help="folder of runs and results")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="these scenes")
    parser.add_argument("--factor", type=int, help="down-scaling; default: the paper's size")
    parser.add_argument("--preset", default="tiny", help="of trainings (default: tiny)")
    parser.add_argument("--models", nargs="+", choices=MODELS, default=MODELS)
    parser.add_argument("--training", default="", help="more options of trainings, one string")
    parser.add_argument("--dry-run", action="store_true", help="only say what would be done")
    wish = vars(parser.parse_args(own))
    dry = wish.pop("dry_run")
    wish["training"] = shlex.split(wish["training"])
    return Wish(**wish, options=options), dry


def main(words: Sequence[str] | None = None) -> int:
    """Make one table."""
    wish, dry = read_wish(sys.argv[1:] if words is None else words)
    if not wish.data.is_dir():
        print(f"{wish.data}: expected a folder of data sets, got none", file=sys.stderr)
        return 2
    if wish.table == "study":
        return _study(wish)
    jobs = plan(wish)
    if dry:
        show(jobs, wish.skipped)
        return 0
    good = work(wish, jobs)
    if wish.table == "nbs" and not _skinning(wish, good):
        return 1
    finish(wish, good)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
