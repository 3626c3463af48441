"""The page of public names: it has all of them, and its examples run."""

import json
import re
import runpy
from pathlib import Path

import pytest
from tests.cli.toys import write_run, write_scene
from tests.seeded_runs import TWIST, write_moving_edit

import pcore

PAGE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "index.md"


def blocks() -> list[str]:
    return re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize("name", [name for name in pcore.__all__ if name != "__version__"])
def test_every_name_is_in_an_example(name: str) -> None:
    assert re.search(rf"\bpcore\.{name}\b", "".join(blocks()))


def test_the_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path / "ball")
    write_run(tmp_path / "runs" / "toy", scene="../../ball", points=80)
    Path("edit.json").write_text(json.dumps({"version": 2, "edits": [TWIST]}))
    write_moving_edit(Path("moving.json"))
    code = compile("\n".join(blocks()), str(PAGE), "exec")
    exec(code, {"__name__": "reference"})
    assert (tmp_path / "runs" / "new-pcore" / "model.safetensors").is_file()


def test_pages_made_from_the_code_are_up_to_date() -> None:
    made = runpy.run_path(str(PAGE.parents[2] / "scripts" / "make_reference.py"))
    for name, page in (("names.md", "names_page"), ("edit-file.md", "edit_file_page")):
        written = (PAGE.parent / name).read_text(encoding="utf-8")
        assert written == made[page](), f"{name}: run `python scripts/make_reference.py`"
