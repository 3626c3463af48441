"""Trained objects are opened in one place; nobody builds on the command line."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SHELL = "pcore.cli"
DOORS = {
    "pcore.files.model_file": {"load_model", "SavedModel"},
    "pcore.files.skinning_file": {"load_skinning"},
    "pcore.relight.light_file": {"load_shading"},
}
"""What reads the files of a trained object; only the room behind the door does."""
PROGRAMS = [*(ROOT / "benchmarks").rglob("*.py"), *(ROOT / "examples").rglob("*.py")]
VERBS = list((ROOT / "src" / "pcore" / "cli").glob("*.py"))
LIBRARY = [
    path for path in (ROOT / "src" / "pcore").rglob("*.py") if path.parent.name not in ("cli",)
]


def imported(path: Path) -> set[tuple[str, str]]:
    """Modules that a file imports, each with a name of it or nothing."""
    found: set[tuple[str, str]] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            found |= {(node.module or "", alias.name) for alias in node.names}
        if isinstance(node, ast.Import):
            found |= {(alias.name, "") for alias in node.names}
    return found


def test_there_is_something_to_check() -> None:
    assert len(PROGRAMS) > 20
    assert len(VERBS) > 20
    assert len(LIBRARY) > 150


@pytest.mark.parametrize("path", [*PROGRAMS, *LIBRARY], ids=lambda path: path.name)
def test_nobody_builds_on_the_command_line(path: Path) -> None:
    names = {f"{module}.{name}" for module, name in imported(path)}
    assert not [name for name in names if name.startswith(SHELL)]


@pytest.mark.parametrize("path", [*PROGRAMS, *VERBS], ids=lambda path: path.name)
def test_objects_come_through_the_door(path: Path) -> None:
    around = {(module, name) for module, names in DOORS.items() for name in names} & imported(path)
    assert not around
    # `RunFolder` is what trainings write; who reads one asks the asset for its record.
    assert "RunFolder" not in path.read_text(encoding="utf-8")


def test_no_file_name_stands_twice() -> None:
    """Whoever looks for a file by its name finds one; verbs are named like what they call."""
    names = [path.name for path in LIBRARY if path.name != "__init__.py"]
    assert names.count("render.py") == 1  # Of Gaussians: they are really counted.
    assert not {name for name in names if names.count(name) > 1}
