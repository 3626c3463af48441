"""The command line: finding verbs, help without torch, errors in one sentence."""

import ast
import inspect
import itertools
import subprocess
import sys
import textwrap
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path

import pytest

from pcore.cli import main as cli
from pcore.cli.main import VERBS, Verb, main
from pcore.errors import CheckpointError


@dataclass(frozen=True, kw_only=True)
class FailCommand:
    """Fail in the way that is asked for."""

    how: str = "no"
    """What happens."""

    def run(self) -> None:
        """Fail."""
        if self.how == "ours":
            raise CheckpointError("the [file] is bad; take another")
        if self.how == "stop":
            raise KeyboardInterrupt
        sys.stdout.write(f"did it {self.how}\n")


@dataclass
class Undocumented:
    """A field without a docstring."""

    speed: int
    width: int
    """This one has one."""


@pytest.fixture
def _fail(monkeypatch: pytest.MonkeyPatch) -> None:
    verb = Verb("break things", __name__, "FailCommand", "fail")
    monkeypatch.setattr(cli, "VERBS", (*VERBS, verb))


@pytest.mark.parametrize("args", [[], ["-h"], ["--help"]])
def test_help_lists_every_verb(args: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(args) == 0
    shown = capsys.readouterr().out
    for verb in VERBS:
        assert verb.name in shown
        assert verb.summary in shown


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("pcore ")


@pytest.mark.parametrize("args", [["--help"], ["--version"], ["trian"]])
def test_what_needs_no_torch_does_not_wait_for_it(args: list[str]) -> None:
    code = (
        "import sys; from pcore.cli.main import main; "
        f"main({args!r}); print([m for m in ('torch', 'numba') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.splitlines()[-1] == "[]"


def test_options_of_verbs_do_not_wait_for_torch() -> None:
    modules = sorted({verb.module for verb in VERBS})
    code = (
        f"import sys, importlib; [importlib.import_module(one) for one in {modules}]; "
        "print([m for m in ('torch', 'numba', 'numpy') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.splitlines()[-1] == "[]"


def undocumented_fields(kind: type) -> list[str]:
    """Names of the fields of a dataclass that no docstring follows."""
    body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    assert isinstance(body, ast.ClassDef)
    pairs = itertools.pairwise([*body.body, ast.Pass()])
    return [
        ast.unparse(field.target)
        for field, after in pairs
        if isinstance(field, ast.AnnAssign)
        and not (isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant))
    ]


def test_the_check_of_docstrings_finds_a_missing_one() -> None:
    assert undocumented_fields(Verb) == []
    assert undocumented_fields(Undocumented) == ["speed"]


@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.name)
def test_every_verb_documents_all_its_options(
    verb: Verb, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "400")
    assert main([*verb.name.split(), "--help"]) == 0
    shown = capsys.readouterr().out
    assert f"usage: pcore {verb.name}" in shown
    kind = getattr(import_module(verb.module), verb.command)
    assert callable(kind.run)
    assert undocumented_fields(kind) == []
    nested = [type(one.default_factory()) for one in fields(kind) if callable(one.default_factory)]
    assert [undocumented_fields(one) for one in nested] == [[] for _ in nested]
    # What stands for a value has a name; "default: None" tells nobody anything.
    assert [word for word in ("{None}", "(default: None)", " PATH", " INT") if word in shown] == []


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["docter"], "unknown command 'docter': expected one of"),
        (["edit", "aply"], "expected one of edit apply, edit list, edit validate; did you mean"),
        (["docter"], "did you mean `pcore doctor`?"),
        (["import", "gausians"], "did you mean `pcore import gaussians`?"),
    ],
)
def test_a_mistyped_verb(args: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(args) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("more", [[], ["--help"], ["-h"]])
def test_a_group_shows_its_verbs(more: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["edit", *more]) == 0
    shown = capsys.readouterr().out
    assert "usage: pcore edit VERB" in shown
    assert [line.split()[1] for line in shown.splitlines() if line.startswith("  edit")] == [
        "apply",
        "list",
        "validate",
    ]


@pytest.mark.usefixtures("_fail")
def test_options_reach_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["break", "things", "--how", "well"]) == 0
    assert capsys.readouterr().out == "did it well\n"


@pytest.mark.usefixtures("_fail")
def test_an_unknown_option(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["break", "things", "--speed", "3"]) == 2
    assert "--speed" in capsys.readouterr().err


@pytest.mark.usefixtures("_fail")
def test_our_errors_are_one_message_without_a_traceback(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["break", "things", "--how", "ours"]) == 2
    said = capsys.readouterr()
    assert said.err == "Error: the [file] is bad; take another\n"
    assert said.out == ""


@pytest.mark.usefixtures("_fail")
def test_debugging_shows_the_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PCORE_DEBUG", "1")
    with pytest.raises(CheckpointError, match="take another"):
        main(["break", "things", "--how", "ours"])


@pytest.mark.usefixtures("_fail")
def test_interrupting(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["break", "things", "--how", "stop"]) == 130
    said = capsys.readouterr().err
    assert "Interrupted" in said
    assert "nothing more was written" in said


def test_a_reader_that_leaves_early_is_no_error(tmp_path: Path) -> None:
    code = (
        "import sys; from pcore.cli.console import guarded\n"
        "def talk():\n"
        "    for _ in range(100000): print('x' * 100)\n"
        "sys.exit(guarded(talk))"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.read(10)
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait() == 0
