"""`pcore study`: blind choices between pictures of methods, and what people chose."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.console import say
from pcore.cli.layout import Sheet, room, sheet_lines
from pcore.cli.options import Count, named_paths, optional
from pcore.cli.output import pictures_folder
from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.study.win_rates import WinRate

_QUOTED = (
    ("PAPR", "83/92", "82/86", "165/178"),
    ("Mani-GS", "100/102", "75/79", "175/181"),
    ("SC-GS", "88/89", "69/77", "157/166"),
)
"""The paper's table of its study: choices of P-CORE over a rival; Neural Editor's scenes, those of
Objaverse, all."""


@dataclass(frozen=True, kw_only=True)
class StudyMakeCommand:
    """Write a page on which people choose the better of two pictures, without knowing whose."""

    pairs: Annotated[tuple[str, ...], arg(metavar="NAME=FOLDER")]
    """Methods and the folders of their pictures or films; files of the same path below them show
    the same. The first is compared with each of the others; its first folder level is the group."""

    output: Annotated[Path, arg(aliases=["-o"], metavar="FOLDER")]
    """New or empty folder for study.html, which goes to people, and key.json, which stays."""

    question: Annotated[str | None, optional("TEXT")] = None
    """What to ask; default: which picture has fewer holes, tears and parts that come apart."""

    per_person: Count = None
    """Pairs that each person sees, drawn at random; default: all."""

    catch: Annotated[int, arg(metavar="N")] = 3
    """Pairs whose answer is known (a picture against itself with holes), to tell who looked."""

    every_pair: bool = False
    """Compare all methods with one another, not just the first with the others."""

    seed: Annotated[int, arg(metavar="N")] = 0
    """Of the catch trials' holes and the pictures' names in the page."""

    def run(self) -> None:
        """Write both files; raises PcoreError subclasses for what the user can mend."""
        from pcore.evaluation.report import require_jinja
        from pcore.study.page import KEY_FILE, PAGE_FILE, QUESTION, write_study
        from pcore.study.trials import plan_study

        require_jinja()
        if self.catch < 0:
            raise InputError(f"--catch: expected 0 or more, got {self.catch}")
        methods = _methods(self.pairs)
        study = plan_study(methods, every_pair=self.every_pair, catch=self.catch, seed=self.seed)
        pictures_folder(self.output, overwrite=None)
        name = write_study(
            self.output,
            study,
            question=self.question or QUESTION,
            per_person=self.per_person,
        )
        caught = sum(one.catch for one in study.trials)
        lines = [
            f"study {name}: {len(study.trials) - caught} pairs and {caught} catch trials",
            f"send {self.output / PAGE_FILE}; keep {self.output / KEY_FILE} to yourself",
            f"then: pcore study read {self.output / KEY_FILE} answers-*.json",
        ]
        if caught < self.catch:
            said = "each needs a picture of its own, and films make none"
            lines.insert(1, f"note: {caught} of {self.catch} catch trials: {said}")
        say(Console(), *lines)


@dataclass(frozen=True, kw_only=True)
class StudyReadCommand:
    """Say what people chose: win rates with exact intervals, and how far they agree."""

    key: Annotated[Positional[Path], arg(metavar="KEY")]
    """key.json of the study."""

    answers: Annotated[Positional[tuple[Path, ...]], arg(metavar="ANSWERS")]
    """Files that people sent back."""

    caught: Annotated[float, arg(metavar="SHARE")] = 0.75
    """Share of the catch trials that somebody must get right to count."""

    def run(self) -> None:
        """Print the table; raises InputError for damaged files."""
        from pcore.study.answers import read_answers, read_key
        from pcore.study.win_rates import agreement, win_rates

        if not 0 <= self.caught <= 1:
            raise InputError(f"--caught: expected a share from 0 to 1, got {self.caught}")
        if not self.answers:
            raise InputError("study read: expected files of answers, got none")
        console, key = Console(), read_key(self.key)
        sheets = read_answers(self.answers, key, caught=self.caught)
        found = win_rates(sheets.people, key)
        lines = [f"note: {note}" for note in sheets.notes]
        lines += sheet_lines(_sheet(found, len(sheets.people)), room(console))
        both = agreement(sheets.people, key)
        if both is not None:
            kappa = "not defined" if both.kappa is None else f"{both.kappa:.2f}"
            lines.append(
                f"agreement of two people on one of {both.pairs} pairs: "
                f"{100 * both.observed:.1f} %, Fleiss' kappa {kappa}"
            )
        say(console, *lines, "", *sheet_lines(_quoted(), room(console)))


def _methods(given: tuple[str, ...]) -> dict[str, Path]:
    found = dict(named_paths("--pairs", given))
    if len({*found.values()}) < len(found):
        folders = ", ".join(map(str, found.values()))
        raise InputError(f"--pairs: expected a folder of each method's own, got {folders}")
    return found


def _sheet(rates: list[WinRate], people: int) -> Sheet:
    rows = tuple(
        (
            (f"{one.first} vs. {one.second}", one.group),
            (
                f"{100 * one.rate:.1f}",
                f"{one.wins}/{one.choices}",
                f"{100 * one.low:.1f}-{100 * one.high:.1f}",
                f"{one.p:.2g}",
            ),
        )
        for one in rates
    )
    columns = ("win rate\n%", "count", "95 %\nexact", "p")
    title = f"{people} {'person' if people == 1 else 'people'}"
    return Sheet(title=title, keys=("pairing", "group"), columns=columns, rows=rows)


def _quoted() -> Sheet:
    rows = tuple(((f"P-CORE vs. {rival}",), tuple(counts)) for rival, *counts in _QUOTED)
    return Sheet(
        title="quoted: the P-CORE paper's study, 25 people, 525 answers",
        keys=("pairing",),
        columns=("Neural\nEditor", "Objaverse", "all"),
        rows=rows,
    )
