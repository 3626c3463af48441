"""The examples of the guide on edit files are valid and do something."""

import json
import re
from pathlib import Path

import torch

from pcore.editing.script import parse_edit


def test_every_example_of_the_guide_works():
    text = (Path(__file__).parents[2] / "docs" / "guide" / "edit-files.md").read_text(
        encoding="utf-8"
    )
    edits = [json.loads(line) for line in re.findall(r"^    (\{.*\})$", text, re.MULTILINE)]
    assert {edit["type"] for edit in edits} == {
        "twist", "bend", "taper", "stretch", "scale", "rigid"
    }  # fmt: skip
    (whole,) = re.findall(r"```json\n(.*?)```", text, re.DOTALL)
    points = torch.rand(500, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1
    for content in [json.loads(whole), *({"version": 1, "edits": [edit]} for edit in edits)]:
        moved = parse_edit(content).bind(points)(points)
        assert float((moved - points).norm(dim=-1).mean()) > 0.05
