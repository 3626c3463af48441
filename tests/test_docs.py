"""What the documentation says exists: commands parse, links lead somewhere, names are found."""

import ast
import re
import shlex
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import tyro

import pcore
from pcore.cli.main import VERBS
from pcore.editing.regions import REGION_SHAPES
from pcore.editing.registry import EDIT_TYPES

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
COMMAND = re.compile(r"(?:/usr/bin/time -v )?(pcore [^`]*)")
LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)")
REPOSITORY_PATH = re.compile(r"`((?:tests|docs|scripts|examples|src)/[\w./-]*)`")
SHORT = (".", "guide", "tutorials")
"""Folders of docs/ whose pages are for users: 100 lines of 100 columns at most."""
NAME = re.compile(r"`(pcore(?:\.\w+)+)`")


def pages_with(pattern: re.Pattern[str]) -> list[Any]:
    return [
        pytest.param(page, id=str(page.relative_to(ROOT)))
        for page in PAGES
        if pattern.search(page.read_text(encoding="utf-8"))
    ]


def code_blocks(page: Path, language: str) -> list[str]:
    """Fenced blocks of a language."""
    text = page.read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)


def commands(page: Path) -> list[str]:
    """Command lines of pcore in fenced and indented blocks; those with "..." are sketches."""
    indented = re.findall(r"^ {4}.*$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    lines = [line.strip() for block in code_blocks(page, "bash") for line in block.splitlines()]
    found = [COMMAND.fullmatch(line.strip()) for line in [*lines, *indented]]
    return [match[1] for match in found if match and "..." not in match[1]]


def parse(words: list[str]) -> Any:
    """Options of a command, without running it."""
    verb = next(v for v in VERBS if words[1 : 1 + len(v.name.split())] == v.name.split())
    kind = getattr(import_module(verb.module), verb.command)
    options = words[1 + len(verb.name.split()) :]
    return tyro.cli(kind, args=options, config=(tyro.conf.FlagCreatePairsOff,))


def resolve(name: str) -> Any:
    """The object of a dotted name; AttributeError when there is none."""
    words = name.split(".")
    modules = [".".join(words[:n]) for n in range(1, len(words) + 1)]
    module = [one for one in modules if import_spec(one)][-1]
    found: Any = import_module(module)
    for word in words[module.count(".") + 1 :]:
        found = getattr(found, word)
    return found


def import_spec(name: str) -> bool:
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:  # Its parent is no package.
        return False


def test_there_are_commands_to_check() -> None:
    page = ROOT / "docs" / "guide" / "commands.md"
    verbs = {
        verb.name
        for verb in VERBS
        for command in commands(page)
        if command.startswith(f"pcore {verb.name}")
    }
    assert verbs == {verb.name for verb in VERBS} - {"doctor"}
    assert "`pcore doctor`" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("page", "lines"),
    [(ROOT / "README.md", 80)]
    + [(page, 100) for folder in SHORT for page in sorted((ROOT / "docs" / folder).glob("*.md"))],
    ids=lambda value: value.name if isinstance(value, Path) else None,
)
def test_pages_for_users_are_short(page: Path, lines: int) -> None:
    found = page.read_text(encoding="utf-8").splitlines()
    assert len(found) <= lines
    assert [line for line in found if len(line) > 100] == []


def test_the_moving_picture_is_small() -> None:
    picture = ROOT / "docs" / "images" / "edit.gif"
    assert picture.stat().st_size <= 2_000_000
    assert f"](docs/images/{picture.name})" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_every_edit_and_region_has_its_figure() -> None:
    figures = (ROOT / "scripts" / "make_figures.py").read_text(encoding="utf-8")
    kinds = [*EDIT_TYPES, *REGION_SHAPES]
    assert [kind for kind in kinds if f'"{kind}"' not in figures] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_merge_was_left_undecided(page: Path) -> None:
    marks = re.compile(r"^(<{7}|={7}|>{7})( |$)", flags=re.MULTILINE)
    assert not marks.search(page.read_text(encoding="utf-8"))


@pytest.mark.parametrize("page", [p for p in pages_with(COMMAND) if commands(p.values[0])])
def test_every_command_parses(page: Path) -> None:
    for command in commands(page):
        words = shlex.split(command, comments=True)
        try:
            assert parse(words) is not None
        except (SystemExit, StopIteration) as end:
            pytest.fail(f"{page.name}: `{command}` does not parse ({end!r})")


@pytest.mark.parametrize("page", pages_with(LINK))
def test_every_link_leads_somewhere(page: Path) -> None:
    targets = LINK.findall(page.read_text(encoding="utf-8"))
    assert [one for one in targets if not (page.parent / one).exists()] == []


@pytest.mark.parametrize("page", pages_with(REPOSITORY_PATH))
def test_every_file_that_is_named_is_there(page: Path) -> None:
    named = REPOSITORY_PATH.findall(page.read_text(encoding="utf-8"))
    assert [one for one in named if not (ROOT / one).exists()] == []


@pytest.mark.parametrize("page", pages_with(NAME))
def test_every_name_is_in_the_code(page: Path) -> None:
    for name in NAME.findall(page.read_text(encoding="utf-8")):
        assert resolve(name) is not None, name


@pytest.mark.parametrize("page", [p for p in pages_with(re.compile("```python"))])
def test_python_blocks_import_what_is_there(page: Path) -> None:
    for block in code_blocks(page, "python"):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pcore"):
                for alias in node.names:
                    resolve(f"{node.module}.{alias.name}")
            elif isinstance(node, ast.Attribute) and ast.unparse(node.value) == "pcore":
                assert node.attr in pcore.__all__ or import_spec(f"pcore.{node.attr}"), node.attr


@pytest.mark.parametrize("page", pages_with(re.compile(r"^\|", re.MULTILINE)))
def test_tables_are_whole(page: Path) -> None:
    """Every row is a line of its own with as many cells as the head; a wrapped row ends a table."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.M)
    for block in re.findall(r"^\|.*(?:\n.+)*", text, flags=re.MULTILINE):
        rows = [re.sub(r"`[^`]*`|\\\|", "", row) for row in block.splitlines()]
        cells = [row.count("|") if row.startswith("|") else 0 for row in rows]
        assert set(cells) == {cells[0]}, block.splitlines()[cells.index(min(cells))]


def test_pages_that_the_code_names_are_there() -> None:
    """Messages and comments send people to pages; a page that moved takes its name along."""
    named = {
        (found, path.name)
        for path in sorted((ROOT / "src").rglob("*.py"))
        for found in re.findall(r"docs/[\w./-]+\.md", path.read_text(encoding="utf-8"))
    }
    assert len(named) > 10
    assert not [one for one in named if not (ROOT / one[0]).is_file()]
