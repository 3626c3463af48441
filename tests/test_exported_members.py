"""What `import pcore` gives: few names, all of them there, none of them paid for before use."""

import ast
import inspect
import subprocess
import sys
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import pytest

import pcore

NAMES = [name for name in pcore.__all__ if name != "__version__"]


def test_names_are_sorted_and_few() -> None:
    assert pcore.__all__ == sorted(set(pcore.__all__))
    assert len(pcore.__all__) <= 40


@pytest.mark.parametrize("name", NAMES)
def test_every_name_is_the_thing_of_its_module(name: str) -> None:
    member = getattr(pcore, name)
    assert member.__name__ == name
    assert member is getattr(import_module(member.__module__), name)
    assert member.__module__.startswith("pcore.")
    assert inspect.getdoc(member)


def test_type_checkers_see_the_same_names_in_the_same_places() -> None:
    tree = ast.parse(Path(inspect.getfile(pcore)).read_text(encoding="utf-8"))
    seen = {
        alias.name: node.module
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == {name: getattr(pcore, name).__module__ for name in NAMES}


def test_all_names_are_listed() -> None:
    assert set(pcore.__all__) <= set(dir(pcore))


def test_version_is_that_of_the_distribution() -> None:
    assert pcore.__version__ == version("pcore-edit")


def test_unknown_names_are_attribute_errors() -> None:
    with pytest.raises(AttributeError, match="module 'pcore' has no attribute 'rendr'"):
        _ = pcore.rendr
    assert not hasattr(pcore, "load_edits")


def test_importing_does_not_wait_for_torch() -> None:
    code = (
        "import sys, pcore; pcore.PcoreError; pcore.__version__; "
        "print([m for m in ('torch', 'numba', 'numpy') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
