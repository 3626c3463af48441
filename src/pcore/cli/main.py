"""`pcore VERB ...`: find the verb, parse its options, hand over.

The modules of the verbs are imported only when their verb is used, so that help and typing
mistakes do not wait for torch.
"""

from __future__ import annotations

import difflib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Protocol

from rich.console import Console
from rich.table import Table

import pcore
from pcore.cli.console import guarded
from pcore.cli.torchrun import refuse_ranks
from pcore.errors import InputError


class Command(Protocol):
    """What a verb's dataclass must be able to do once its options are parsed."""

    def run(self) -> None:
        """Do it; raise `PcoreError` for what the user can mend."""
        ...


@dataclass(frozen=True)
class Verb:
    """One entry of the command line."""

    name: str
    """One or two words."""
    module: str
    """Module that defines it, imported on use."""
    command: str
    """The frozen dataclass in it whose fields are the options; it has a method `run()`."""
    summary: str
    """One line for `pcore --help`."""


VERBS: tuple[Verb, ...] = (
    Verb("demo", "pcore.cli.demo", "DemoCommand", "the whole story on a sample, with a report"),
    Verb("check", "pcore.cli.check", "CheckCommand", "look at a scene before it is trained"),
    Verb("train", "pcore.cli.train", "TrainCommand", "learn a scene from its photos"),
    Verb(
        "finetune",
        "pcore.cli.finetune",
        "FinetuneCommand",
        "teach a run consistent surfaces (P-CORE)",
    ),
    Verb("light", "pcore.cli.light", "LightCommand", "estimate the light, so that it stays put"),
    Verb("render", "pcore.cli.render", "RenderCommand", "take pictures of a run, also deformed"),
    Verb("view", "pcore.cli.view", "ViewCommand", "look at a run, or make one HTML file of it"),
    Verb("studio", "pcore.cli.studio", "StudioCommand", "edit a run by hand, in the browser"),
    Verb("animate", "pcore.cli.animate", "AnimateCommand", "film a run under keyframes"),
    Verb("fit", "pcore.cli.fit", "FitCommand", "find the pose of a run in photos of another state"),
    Verb("eval", "pcore.cli.eval", "EvalCommand", "score a run on true images, also deformed"),
    Verb("compare", "pcore.cli.compare", "CompareCommand", "score rival methods beside our own"),
    Verb("ablate", "pcore.cli.ablate", "AblateCommand", "fine-tune with parts left out, compare"),
    Verb("sweep", "pcore.cli.sweep", "SweepCommand", "run a plan: scenes x settings x seeds"),
    Verb("study make", "pcore.cli.study", "StudyMakeCommand", "ask people which of two is better"),
    Verb("study read", "pcore.cli.study", "StudyReadCommand", "say what people chose"),
    Verb(
        "benchmark make",
        "pcore.cli.benchmark",
        "BenchmarkMakeCommand",
        "make true pictures of the deformed states of a model",
    ),
    Verb("edit apply", "pcore.cli.edit", "ApplyCommand", "move points, say how the edit does"),
    Verb("edit list", "pcore.cli.edit", "ListCommand", "say what an edit file does"),
    Verb("edit validate", "pcore.cli.edit", "ValidateCommand", "check an edit file"),
    Verb("deform", "pcore.cli.deform", "DeformCommand", "apply an edit file to any points"),
    Verb(
        "import papr",
        "pcore.cli.import_papr",
        "ImportPaprCommand",
        "make a run of an official PAPR checkpoint",
    ),
    Verb(
        "import gaussians",
        "pcore.cli.import_gaussians",
        "ImportGaussiansCommand",
        "make a run of a 3DGS file",
    ),
    Verb("export", "pcore.cli.export", "ExportCommand", "write a run for other programs"),
    Verb(
        "blender export",
        "pcore.cli.blender",
        "BlenderExportCommand",
        "write a run for the add-on for Blender",
    ),
    Verb("info", "pcore.cli.info", "InfoCommand", "say what a run, scene, edit or model file is"),
    Verb("doctor", "pcore.cli.doctor", "DoctorCommand", "check this machine"),
)
"""In the order of the help; a new verb is one more line."""
_SHARING = ("train", "finetune", "render", "animate", "eval", "compare")
"""Verbs whose work several processes of torchrun share."""


def main(args: Sequence[str] | None = None) -> int:
    """Run the command line `args` (default: of the process) and return its exit code."""
    words = list(sys.argv[1:] if args is None else args)
    try:
        return guarded(lambda: _dispatch(words))
    except SystemExit as end:  # The parser's way to say that it has shown help or an error.
        return end.code if isinstance(end.code, int) else 0


def _dispatch(words: list[str]) -> None:
    if not words or words[0] in ("-h", "--help"):
        _show_help()
    elif words[0] == "--version":
        print(f"pcore {pcore.__version__}")
    elif (group := _group(words)) and words[1:] in ([], ["-h"], ["--help"]):
        console = Console()
        console.print(f"usage: pcore {words[0]} VERB [OPTIONS]\n", markup=False)
        console.print(_table(group))
        console.print(f"\n`pcore {group[0].name} --help` shows its options.", markup=False)
    else:
        verb = _find(words)
        if verb.name not in _SHARING:
            refuse_ranks(f"pcore {verb.name}")
        command_of(verb, words[len(verb.name.split()) :]).run()


def command_of(verb: Verb, options: Sequence[str]) -> Command:
    """Parse the options of a verb; SystemExit, after saying why on stderr, where they are wrong."""
    import tyro

    kind: type[Command] = getattr(import_module(verb.module), verb.command)
    return tyro.cli(
        kind,
        prog=f"pcore {verb.name}",
        args=options,
        config=(tyro.conf.FlagCreatePairsOff,),
    )


def _group(words: Sequence[str]) -> list[Verb]:
    """Verbs of two words that begin with the first of these."""
    return [verb for verb in VERBS if verb.name.startswith(f"{words[0]} ")]


def _table(verbs: Sequence[Verb]) -> Table:
    table = Table(box=None, show_header=False, padding=(0, 2))
    for verb in verbs:
        table.add_row(verb.name, verb.summary)
    return table


def _find(words: list[str]) -> Verb:
    """Return the verb that the words begin with; raises InputError that suggests one."""
    for verb in VERBS:
        name = verb.name.split()
        if words[: len(name)] == name:
            return verb
    group = _group(words)
    given = " ".join(words[: 2 if group else 1])
    names = ", ".join(verb.name for verb in group or VERBS)
    close = difflib.get_close_matches(given, [verb.name for verb in group or VERBS], n=1)
    hint = f"; did you mean `pcore {close[0]}`?" if close else ""
    raise InputError(f"unknown command {given!r}: expected one of {names}{hint}")


def _show_help() -> None:
    console = Console()
    console.print("usage: pcore VERB [OPTIONS]\n", markup=False)
    console.print(
        "Edit captured objects: photos in, an object that is deformed and drawn without holes.\n"
    )
    console.print(_table(VERBS))
    console.print("\n`pcore VERB --help` shows its options; `pcore --version` the version.")
    console.print("With PCORE_DEBUG=1 in the environment errors show where they were raised.")


if __name__ == "__main__":
    sys.exit(main())
