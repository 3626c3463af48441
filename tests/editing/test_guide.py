"""The examples of the guide on editing are valid and do something."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from tests.cli.toys import write_run

import pcore
from pcore.editing.animation import Animation
from pcore.editing.session import EditSession

JSON_BLOCK = re.compile(r"```json\n(.*?)```", re.DOTALL)
GUIDE = Path(__file__).parents[2] / "docs" / "guide"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> torch.Tensor:
    """Points, and the files that the examples name, in the working directory."""
    monkeypatch.chdir(tmp_path)
    points = torch.rand(500, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1
    box = trimesh.creation.box(extents=(2.2, 2.2, 2.2))
    for name in ("cage.ply", "proxy.obj"):
        box.export(name)
    box.vertices = box.vertices * [1, 1, 1.5] + [0.2, 0, 0]
    for name in ("cage_bent.ply", "proxy_posed.obj"):
        box.export(name)
    np.save("old.npy", points.numpy())
    np.save("new.npy", (1.2 * points).numpy())
    return points


EDIT_PAGES = ("edit-files", "edit-types", "edit-shapes", "edit-keys", "regions")


def indented_edits(text: str) -> list[dict[str, Any]]:
    """JSON objects of indented blocks, which may go over several lines."""
    bare = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    blocks = re.findall(r"(?:^    .*\n)+", bare, re.MULTILINE)
    return [json.loads(block) for block in blocks if block.startswith("    {")]


def test_every_example_of_the_guide_works(here: torch.Tensor):
    texts = [(GUIDE / f"{page}.md").read_text(encoding="utf-8") for page in EDIT_PAGES]
    edits = [edit for text in texts for edit in indented_edits(text)]
    assert {edit["type"] for edit in edits} == {
        "twist", "bend", "taper", "stretch", "scale", "rigid",
        "part", "cage", "mesh", "displacement", "anchors",
    }  # fmt: skip
    whole = [json.loads(one) for text in texts for one in JSON_BLOCK.findall(text)]
    assert len(whole) == 3
    for content in [*whole, *({"version": 2, "edits": [edit]} for edit in edits)]:
        animation = Animation(content)
        moved = animation.at(animation.end).bind(here)(here)
        way = (moved - here).norm(dim=-1)
        assert float(way.max()) > 0.05
        local = ("region" in edit or edit["type"] == "anchors" for edit in content["edits"])
        if not any(local):
            assert float(way.mean()) > 0.05


def python_of(page: str) -> list[str]:
    """Python blocks of a page of the guide."""
    text = (GUIDE / page).read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> torch.Tensor:
    """Points of two runs that were never trained, which the guide names, and a cage around them."""
    monkeypatch.chdir(tmp_path)
    for name in ("toy-pcore", "knight"):
        write_run(tmp_path / "runs" / name, points=400)
    trimesh.creation.icosphere(subdivisions=2).export("cage.ply")
    return pcore.load("runs/toy-pcore").points


def test_the_session_of_the_guide_runs(runs: torch.Tensor):
    names: dict[str, object] = {}
    blocks = python_of("sessions.md")
    assert len(blocks) == 2
    for block in blocks:
        exec(compile(block, "sessions.md", "exec"), names)
    session = names["session"]
    assert isinstance(session, EditSession)
    assert [edit.type for edit in session.state.script.edits] == ["twist", "cage"]
    low = runs[:, 2] < -0.6
    assert torch.equal(session.state.points[low], runs[low])
    assert json.loads(Path("edit.json").read_text(encoding="utf-8"))["edits"][0]["angle_deg"] == 40


def test_the_drag_of_the_guide_runs(runs: torch.Tensor):
    names: dict[str, object] = {}
    exec(compile(python_of("anchors.md")[0], "anchors.md", "exec"), names)
    moved = names["moved"]
    rest = pcore.load("runs/knight").points
    assert isinstance(moved, torch.Tensor)
    assert float((moved - rest).norm(dim=-1).max()) > 0.3
