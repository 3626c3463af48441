"""Edit files against whole objects that Blender deformed (the ground truth of the benchmarks)."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from pcore.editing.script import parse_edit


def edit_of(settings: dict) -> dict:
    if settings["type"] == "scale":
        return {"type": "scale", "factor": settings["factor"], "origin": settings["origin"]}
    edit = {
        "type": settings["method"].lower(),
        "axis": settings["axis"].lower(),
        "limits": settings["limits"],
        "origin": settings["origin"],
    }
    if settings["value_is"] == "angle_rad":
        return {**edit, "angle_deg": float(np.rad2deg(settings["value"]))}
    return {**edit, "factor": settings["value"]}


@pytest.mark.parametrize("name", ["spot", "knight", "robot"])
@pytest.mark.parametrize("state", ["twist60", "bend60", "stretch", "scale2x"])
def test_edit_files_move_every_vertex_as_blender_did(shared_data: Path, name: str, state: str):
    folder = shared_data / "deformed" / name
    settings = json.loads((folder / state / "deformation.json").read_text())
    with np.load(folder / "meshes.npz") as meshes:
        canonical = torch.from_numpy(meshes["canonical"])
        expected = torch.from_numpy(meshes[state])
    # Strict: these must also be maps that a run may render.
    deformation = parse_edit({"version": 2, "edits": [edit_of(settings)]}).bind(canonical)
    error = (deformation(canonical) - expected).abs().max()
    assert float(error) < 1e-5 * float(expected.amax() - expected.amin())
