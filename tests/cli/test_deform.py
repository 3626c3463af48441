"""`pcore deform`."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import tyro

from pcore.cli.deform import DeformCommand
from pcore.cli.deform_gaussians import deform
from pcore.data.points import read_point_file, save_points
from pcore.errors import EditError, InputError

TWIST = {"type": "twist", "axis": "z", "angle_deg": 60}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    points = torch.rand(100, 3, generator=torch.Generator().manual_seed(4)) - 0.5
    save_points(tmp_path / "in.npy", points)
    write_edit(tmp_path, TWIST)
    return tmp_path


def write_edit(folder: Path, *edits: dict) -> None:
    (folder / "edit.json").write_text(json.dumps({"version": 2, "edits": edits}))


def run(folder: Path, source: str = "in.npy", output: str = "out.npy", **options) -> Path:
    command = DeformCommand(
        input=folder / source, edit=folder / "edit.json", output=folder / output, **options
    )
    deform(command)
    return folder / output


def test_parses_as_a_command_line():
    words = ["in.npy", "--edit", "edit.json", "-o", "out.npy"]
    command = tyro.cli(DeformCommand, args=words)
    assert command == DeformCommand(
        input=Path("in.npy"), edit=Path("edit.json"), output=Path("out.npy"), strict=False
    )
    assert tyro.cli(DeformCommand, args=[*words[:3], "--output", "b.ply", "--strict"]).strict


def test_moves_points_and_says_so(folder: Path, capsys: pytest.CaptureFixture[str]):
    output = run(folder)
    before, after = np.load(folder / "in.npy"), np.load(output)
    assert after.dtype == np.float32
    angle = np.deg2rad(60) * before[:, 2] / np.ptp(before[:, 2])
    x = before[:, 0] * np.cos(angle) - before[:, 1] * np.sin(angle)
    np.testing.assert_allclose(after[:, 0], x, atol=1e-6)
    printed = capsys.readouterr().out
    assert "100 points, twist" in printed
    largest = np.linalg.norm(after - before, axis=1).max()
    assert f"{largest:.4g} at most" in printed
    assert f"written to {output}" in printed
    assert "note" not in printed


def test_the_command_runs_itself(folder: Path):
    DeformCommand(
        input=folder / "in.npy", edit=folder / "edit.json", output=folder / "out.ply"
    ).run()
    assert len(read_point_file(folder / "out.ply").positions) == 100


def test_double_precision_is_kept(folder: Path):
    points = np.load(folder / "in.npy").astype(np.float64) / 3
    np.save(folder / "in.npy", points)
    write_edit(folder, {"type": "scale", "factor": 3})
    moved = np.load(run(folder))
    assert moved.dtype == np.float64
    np.testing.assert_allclose(moved, 3 * points, rtol=1e-15)


def test_a_mesh_stays_a_mesh(folder: Path):
    points = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 0]])
    colors = torch.arange(12, dtype=torch.uint8).reshape(4, 3)
    faces = torch.tensor([[0, 1, 2], [2, 3, 0]])
    save_points(folder / "in.ply", points, colors, faces)
    write_edit(folder, {"type": "rigid", "translation": [0, 0, 2]})
    moved = read_point_file(run(folder, "in.ply", "out.ply"))
    torch.testing.assert_close(moved.positions, points + torch.tensor([0.0, 0, 2]))
    assert torch.equal(moved.faces, faces)
    assert torch.equal(moved.colors[:, :3], colors)


def test_no_edits_changes_nothing(folder: Path, capsys: pytest.CaptureFixture[str]):
    write_edit(folder)
    assert np.array_equal(np.load(run(folder)), np.load(folder / "in.npy"))
    assert "100 points, no edit" in capsys.readouterr().out


def test_folds_are_reported_or_refused(folder: Path, capsys: pytest.CaptureFixture[str]):
    write_edit(folder, {"type": "bend", "axis": "z", "angle_deg": 300})
    points = np.load(folder / "in.npy")
    rate = np.deg2rad(300) / np.ptp(points[:, 0])
    folded = int((1 - rate * points[:, 1] <= 0).sum())
    assert 0 < folded < 100
    run(folder)
    assert f"inside out at {folded} of 100 points" in capsys.readouterr().out
    (folder / "out.npy").unlink()
    with pytest.raises(EditError, match=f"edit 1 .bend.: singular deformation.*at {folded} of 100"):
        run(folder, strict=True)
    assert not (folder / "out.npy").exists()


def test_a_singular_deformation_is_refused(folder: Path):
    span = {"extent": [0, 1]}
    write_edit(folder, {"type": "stretch", "axis": "z", "factor": -1, **span, "limits": [0, 1]})
    points = np.load(folder / "in.npy")
    points[:, 2] = np.abs(points[:, 2])
    np.save(folder / "in.npy", points)
    with pytest.raises(EditError, match=r"singular deformation.*at 100 of 100 points"):
        run(folder)
    assert not (folder / "out.npy").exists()


@pytest.mark.parametrize(
    ("output", "error", "message"),
    [
        ("in.npy", InputError, "expected an output other than the input, got the same file"),
        ("out.txt", InputError, "ends in .npy or .ply, got '.txt'"),
        ("none/out.npy", InputError, "expected an existing folder to write to"),
    ],
)
def test_bad_outputs(folder: Path, output: str, error: type[Exception], message: str):
    before = (folder / "in.npy").read_bytes()
    with pytest.raises(error, match=message):
        run(folder, output=output)
    assert (folder / "in.npy").read_bytes() == before


def test_bad_inputs(folder: Path):
    with pytest.raises(InputError, match=r"none\.npy: no such file"):
        run(folder, "none.npy")
    (folder / "edit.json").write_text("{")
    with pytest.raises(EditError, match=r"edit\.json: expected JSON"):
        run(folder)
    assert not (folder / "out.npy").exists()


# --- places far from the origin -----------------------------------------------------------------

UTM = torch.tensor([512_345.0, 5_412_345.0, 432.0], dtype=torch.float64)
AT_UTM = UTM.tolist()


def write_far(folder: Path, name: str, offset: torch.Tensor, dtype: torch.dtype) -> torch.Tensor:
    points = np.load(folder / "in.npy").astype(np.float64)
    save_points(folder / name, (torch.from_numpy(points) + offset).to(dtype))
    return torch.from_numpy(points)


@pytest.mark.parametrize("scale", [1.0, 1000.0])
@pytest.mark.parametrize(
    "edit",
    [
        {"type": "twist", "axis": "z", "angle_deg": 60},
        {"type": "twist", "axis": [1, 2, 3], "angle_deg": 60},
        {"type": "bend", "axis": "z", "angle_deg": 60},
        {"type": "taper", "axis": "z", "factor": 0.5},
        {"type": "stretch", "axis": "z", "factor": 0.5, "profile": "volume"},
        {"type": "scale", "factor": 0.5},
        {"type": "rigid", "axis": "y", "angle_deg": 20, "translation": [1, 0, 0]},
    ],
    ids=lambda edit: f"{edit['type']}-{edit.get('axis', '')}",
)
def test_far_off_points_move_as_they_do_at_the_origin(
    folder: Path, capsys: pytest.CaptureFixture[str], edit: dict, scale: float
):
    offset = scale * UTM
    write_far(folder, "far.npy", offset, torch.float64)
    write_edit(folder, edit)
    near = read_point_file(run(folder, output="near.npy")).positions
    write_edit(folder, {**edit, "origin": offset.tolist()})
    far = read_point_file(run(folder, "far.npy", "moved.npy")).positions
    assert far.dtype == torch.float64
    # The origin's own numbers have steps of 1e-9 and, a thousand times farther off, of 1e-6.
    np.testing.assert_allclose(far - offset, near, atol=2e-7 + 4e-9 * scale)
    assert "turns it inside out" not in capsys.readouterr().out


@pytest.mark.parametrize("axis", ["z", [1, 2, 3]])
def test_turning_about_a_far_origin_is_a_shear_and_no_fold(
    folder: Path, capsys: pytest.CaptureFixture[str], axis: object
):
    write_far(folder, "far.npy", UTM, torch.float64)
    write_edit(folder, {**TWIST, "axis": axis})
    run(folder, "far.npy")
    shown = capsys.readouterr().out
    assert "shears space more than a run can render at 100 of 100 points" in shown
    assert 'is its "origin" far from them?' in shown
    assert "turns it inside out" not in shown
    assert np.load(folder / "out.npy").dtype == np.float64


@pytest.mark.parametrize("matters", [{"type": "taper", "axis": "z", "factor": -2.5}])
def test_folds_are_still_folds(folder: Path, capsys: pytest.CaptureFixture[str], matters: dict):
    write_edit(folder, matters)
    run(folder)
    shown = capsys.readouterr().out
    assert "flattens space or turns it inside out at" in shown
    assert "shears" not in shown


def test_maps_that_flatten_everything_are_refused_wherever_the_points_are(folder: Path):
    write_far(folder, "far.npy", UTM, torch.float64)
    write_edit(folder, {"type": "bend", "axis": "z", "angle_deg": 60})  # About the far origin.
    with pytest.raises(EditError, match="turned inside out"):
        run(folder, "far.npy")


def test_coordinates_are_shown_with_the_digits_of_the_object(
    folder: Path, capsys: pytest.CaptureFixture[str]
):
    points = write_far(folder, "far.npy", UTM, torch.float64) + UTM
    write_edit(folder, {**TWIST, "origin": AT_UTM})
    run(folder, "far.npy")
    shown = capsys.readouterr().out
    number = float(shown.split("before: x ")[1].split(" ")[0])
    assert number == pytest.approx(float(points[:, 0].min()), abs=1e-3)
    assert "precision" not in shown


def test_files_too_coarse_for_their_coordinates_are_told_of(
    folder: Path, capsys: pytest.CaptureFixture[str]
):
    write_far(folder, "far.npy", UTM, torch.float32)
    write_edit(folder, {**TWIST, "origin": AT_UTM})
    run(folder, "far.npy")
    shown = capsys.readouterr().out
    assert "numbers of the file's precision are 0.65 apart at these coordinates" in shown
    assert "write it in double precision or near the origin" in shown
