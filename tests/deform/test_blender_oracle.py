"""Our simple deforms against Blender's own output, file by file."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from pcore.deform.frame import AXIS_NAMES, axis_frame, bend_frame
from pcore.deform.simple import Bend, SimpleDeform, Stretch, Taper, Twist
from pcore.editing.script import parse_edit

ALONG_AXIS = {"TWIST": Twist, "TAPER": Taper, "STRETCH": Stretch}
AMOUNTS = {
    "TWIST": ("15deg_cube", "45deg_cube", "m30deg_cube"),
    "BEND": ("15deg_cube", "45deg_cube", "180deg_cube", "m30deg_cube"),
    "TAPER": ("f0.5_cube", "f2.0_cube", "fm0.5_cube"),
    "STRETCH": ("f0.5_cube", "f2.0_cube", "fm0.3_cube"),
}
SETUPS = (
    "bunny",
    "cube_limits04-10",
    "random_limits025-075",
    "random_lockY",
    "random_origin",
)
CASES = [
    f"{method}_{axis}_{case}"
    for method, amounts in AMOUNTS.items()
    for axis in "XYZ"
    for case in (
        *amounts,
        *(f"{'60deg' if method in ('TWIST', 'BEND') else 'f1.0'}_{setup}" for setup in SETUPS),
    )
]


def load(folder: Path, case: str):
    with np.load(folder / "oracle" / "simple_deform" / f"{case}.npz") as data:
        arrays = {
            key: torch.from_numpy(data[key].copy()) for key in data.files if key != "settings"
        }
        return arrays, json.loads(str(data["settings"]))


def from_blender(arrays: dict[str, torch.Tensor], settings: dict) -> SimpleDeform:
    """The deformation that a Blender modifier describes, frozen to its vertices."""
    assert torch.equal(arrays["object_matrix_world"], torch.eye(4, dtype=torch.float64))
    turn = torch.eye(3, dtype=torch.float64)
    origin = torch.zeros(3, dtype=torch.float64)
    if settings["origin_object"]:
        turn = arrays["origin_matrix_world"][:3, :3].T
        origin = arrays["origin_matrix_world"][:3, 3]
    axis, method = settings["deform_axis"].lower(), settings["method"]
    frame = bend_frame(axis) if method == "BEND" else axis_frame(axis)
    rotation = frame @ turn
    driving = rotation[0 if method == "BEND" else 2]
    along = (arrays["vertices"].double() - origin) @ driving
    common = {
        "rotation": rotation,
        "origin": origin,
        "extent": (along.min().item(), along.max().item()),
        "limits": tuple(settings["limits"]),
        "value": settings["value"],
    }
    if method == "BEND":
        return Bend(**common)
    index = AXIS_NAMES.index(axis)
    lock = settings["lock_xyz"]
    return ALONG_AXIS[method](
        **common, lock=(bool(lock[(index + 1) % 3]), bool(lock[(index + 2) % 3]))
    )


def relative_error(ours: torch.Tensor, theirs: torch.Tensor) -> float:
    size = (theirs.amax(dim=0) - theirs.amin(dim=0)).max()
    return float((ours - theirs).abs().max() / size)


def test_every_file_is_a_case(shared_data: Path):
    files = {path.stem for path in (shared_data / "oracle" / "simple_deform").glob("*.npz")}
    assert files == set(CASES)
    assert len(CASES) == len(set(CASES)) == 99


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_agrees_with_blender(shared_data: Path, case: str, dtype: torch.dtype):
    arrays, settings = load(shared_data, case)
    ours = from_blender(arrays, settings)(arrays["vertices"].to(dtype))
    assert ours.dtype == dtype
    assert relative_error(ours, arrays["deformed"]) < 1e-5


@pytest.mark.parametrize("case", [case for case in CASES if not case.endswith("origin")])
def test_the_edit_file_agrees_with_blender(shared_data: Path, case: str):
    arrays, settings = load(shared_data, case)
    edit = {
        "type": settings["method"].lower(),
        "axis": settings["deform_axis"].lower(),
        "limits": settings["limits"],
        "lock": [name for name, on in zip("xyz", settings["lock_xyz"], strict=True) if on],
    }
    if settings["value_is"] == "angle_rad":
        edit["angle_deg"] = float(np.rad2deg(settings["value"]))
    else:
        edit["factor"] = settings["value"]
    script = parse_edit({"version": 2, "edits": [edit]})
    # Several of these cases fold the cube on purpose; Blender does not mind.
    deformation = script.bind(arrays["vertices"], allow_folds=True)
    assert relative_error(deformation(arrays["vertices"]), arrays["deformed"]) < 1e-5
