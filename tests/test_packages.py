"""Packages of extras: what is said where one is missing; and the names of our own files."""

import ast
import sys
import tomllib
from pathlib import Path

import pytest

from pcore.errors import DependencyError
from pcore.packages import package

REPOSITORY = Path(__file__).resolve().parent.parent


def test_a_package_that_is_missing_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(DependencyError) as caught:
        package("OpenEXR", extra="mesh", need="writing EXR needs", instead="or write PNG")
    assert str(caught.value) == (
        "writing EXR needs the package OpenEXR, which is not installed: "
        "`pip install 'pcore-edit[mesh]'`, or write PNG"
    )
    assert package("json", extra="mesh", need="this needs").loads("[1]") == [1]


def test_every_extra_that_is_named_exists() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    extras = set(project["project"]["optional-dependencies"])
    named: set[str] = set()
    for path in (REPOSITORY / "src").rglob("*.py"):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "package":
                named |= {
                    word.value.value
                    for word in call.keywords
                    if word.arg == "extra" and isinstance(word.value, ast.Constant)
                }
    assert len(named) > 5
    assert named <= extras
