"""The examples of the guide on edit files are valid and do something."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from pcore.editing.animation import parse_animation


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


def test_every_example_of_the_guide_works(here: torch.Tensor):
    text = (Path(__file__).parents[2] / "docs" / "guide" / "edit-files.md").read_text(
        encoding="utf-8"
    )
    edits = [json.loads(line) for line in re.findall(r"^    (\{.*\})$", text, re.MULTILINE)]
    assert {edit["type"] for edit in edits} == {
        "twist", "bend", "taper", "stretch", "scale", "rigid",
        "part", "cage", "mesh", "displacement", "anchors",
    }  # fmt: skip
    whole = [json.loads(one) for one in re.findall(r"```json\n(.*?)```", text, re.DOTALL)]
    assert len(whole) == 3
    for content in [*whole, *({"version": 2, "edits": [edit]} for edit in edits)]:
        animation = parse_animation(content)
        moved = animation.at(animation.end).bind(here)(here)
        way = (moved - here).norm(dim=-1)
        assert float(way.max()) > 0.05
        local = ("region" in edit or edit["type"] == "anchors" for edit in content["edits"])
        if not any(local):
            assert float(way.mean()) > 0.05
