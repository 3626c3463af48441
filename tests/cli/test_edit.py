"""`pcore edit apply | list | validate`."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from toys import write_run, write_scene

from pcore.cli.main import main
from pcore.data.points import read_point_file

SHIFT = {"type": "rigid", "translation": [0, 0, 0.2]}
LOW = {"shape": "half_space", "normal": [0, 0, -1], "origin": [0, 0, -0.3], "falloff": 1.2}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_run(tmp_path / "run")
    points = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1)
    np.save(tmp_path / "points.npy", points.numpy())
    write_edit(tmp_path, SHIFT, freeze=[LOW])
    return tmp_path


def write_edit(folder: Path, *edits: dict, **more: object) -> Path:
    path = folder / "edit.json"
    path.write_text(json.dumps({"version": 2, "edits": edits, **more}))
    return path


def call(capsys: pytest.CaptureFixture[str], *args: object) -> tuple[int, str]:
    code = main(["edit", *map(str, args)])
    shown = capsys.readouterr()
    return code, shown.out + shown.err


def test_apply_to_points(folder: Path, capsys: pytest.CaptureFixture[str]):
    edit, output = folder / "edit.json", folder / "moved.npy"
    code, shown = call(capsys, "apply", folder / "points.npy", "--edit", edit, "-o", output)
    assert code == 0
    before, after = np.load(folder / "points.npy"), np.load(output)
    low = before[:, 2] <= -0.3
    assert np.array_equal(after[low], before[low])
    assert "1. rigid: origin [0.0, 0.0, 0.0]" in shown
    assert "frozen: half_space (falloff 1.2" in shown
    way = np.linalg.norm(after - before, axis=1)
    assert f"{way.mean():.4g} on average" in shown
    assert f"{int((way == 0).sum())} did not move" in shown
    assert "strain: 1." in shown
    assert "hole score: 0.0 % of the points" in shown
    assert "self-intersection: 0.0 %" in shown
    assert "exposed: not known, points alone have no scene; give it with --scene" in shown
    assert "handles" not in shown


def test_apply_to_a_run_in_colours(folder: Path, capsys: pytest.CaptureFixture[str]):
    write_edit(folder, {"type": "scale", "factor": 4})
    output, picture = folder / "moved.ply", folder / "strain.png"
    words = ["--edit", folder / "edit.json", "-o", output, "--colors", "strain"]
    code, shown = call(capsys, "apply", folder / "run", *words, "--picture", picture)
    assert code == 0
    assert "hole score: 0.0 % of the points come apart" in shown
    assert "with plain rays 100.0 % stand too far apart" in shown
    colors = read_point_file(output).colors
    assert (colors[:, :3] == torch.tensor([214, 38, 31])).all()
    with Image.open(picture) as image:
        half = image.width // 2
        pixels = np.asarray(image)
    # Strain on the left, holes on the right, in three views, and below them a legend.
    points, legend = pixels[:-90], pixels[-90:]
    for view in np.array_split(points, 3):
        assert (view[:, :half] == [214, 38, 31]).all(axis=-1).sum() > 100
        assert not (view[:, half:] == [214, 38, 31]).all(axis=-1).any()
        assert (view[:, half:] == 209).all(axis=-1).sum() > 100
    for color in ([214, 38, 31], [33, 92, 199], [191, 26, 191], [250, 189, 5], [237, 107, 13]):
        assert (legend == color).all(axis=-1).sum() > 100


def test_what_the_training_views_never_saw_comes_to_light(
    folder: Path, capsys: pytest.CaptureFixture[str]
):
    scene, output = folder / "ball", folder / "moved.ply"
    write_scene(scene)
    # All training cameras look from above: below the ball nothing was seen.
    write_run(folder / "trained", scene="../ball", factor=1, points=3000)
    write_edit(folder, {"type": "rigid", "axis": "x", "angle_deg": 180})
    words = ["--edit", folder / "edit.json", "-o", output, "--colors", "strain"]
    code, shown = call(capsys, "apply", folder / "trained", *words)
    assert code == 0
    yellow = read_point_file(output).colors[:, :3] == torch.tensor([250, 189, 5])
    share = float(yellow.all(dim=1).double().mean())
    assert 0.05 < share < 0.5
    assert f"exposed: {100 * share:.1f} % of the points came to light" in shown
    write_edit(folder)
    assert "exposed: 0.0 %" in call(capsys, "apply", folder / "trained", *words)[1]
    words += ["--scene", scene]
    assert "exposed: 0.0 %" in call(capsys, "apply", folder / "points.npy", *words)[1]
    _, shown = call(capsys, "apply", folder / "run", *words[:-2])
    assert "exposed: not known, the scene of the run is not here; give it with --scene" in shown


def test_handles_are_diagnosed(folder: Path, capsys: pytest.CaptureFixture[str]):
    handle = {"near": [0, 0, 1], "to": [0, 0, 2]}
    pull = {"type": "anchors", "count": 20, "handles": [handle]}
    write_edit(folder, {"type": "scale", "factor": 1}, {**pull, "reach": 100})
    words = [folder / "points.npy", "--edit", folder / "edit.json", "-o", folder / "moved.npy"]
    code, shown = call(capsys, "apply", *words)
    assert code == 0
    (line,) = [line for line in shown.splitlines() if line.startswith("edit 2, handles: ")]
    loose = float(line.split("; ")[1].split(" %")[0])
    assert 40 < loose < 100
    words[-1] = folder / "moved.ply"
    assert call(capsys, "apply", *words, "--colors", "handles")[0] == 0
    teal = read_point_file(words[-1]).colors[:, :3] == torch.tensor([13, 140, 140])
    brown = read_point_file(words[-1]).colors[:, :3] == torch.tensor([140, 76, 26])
    assert 100 * float(teal.all(dim=1).double().mean()) <= loose + 0.1
    covered = float((teal.all(dim=1) | brown.all(dim=1)).double().mean())
    assert 100 * covered >= loose - 0.1
    assert call(capsys, "apply", *words, "--colors", "holes")[0] == 0
    write_edit(folder, SHIFT)
    code, shown = call(capsys, "apply", *words, "--colors", "handles")
    assert code == 2
    assert "--colors handles: expected an edit by anchors in" in shown


def test_apply_at_a_time(folder: Path, capsys: pytest.CaptureFixture[str]):
    track = {"keyframes": [[0, 1], [2, 3]]}
    edit, output = write_edit(folder, {"type": "scale", "factor": track}), folder / "moved.npy"
    words = [folder / "points.npy", "--edit", edit, "-o", output]
    code, shown = call(capsys, "apply", *words)
    assert code == 2
    assert "expected --time between 0 and 2 (time= in Python), because it has keyframes" in shown
    assert not output.exists()
    assert call(capsys, "apply", *words, "--time", 1)[0] == 0
    np.testing.assert_allclose(np.load(output), 2 * np.load(folder / "points.npy"), rtol=1e-6)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["-o", "moved.npy", "--colors", "strain"], "expected a .ply for --colors"),
        (["-o", "moved.txt"], "ends in .npy or .ply"),
        (["-o", "moved.npy", "--picture", "a.jpg"], "expected a picture that ends in .png"),
    ],
)
def test_bad_outputs(folder: Path, words: list[str], expected: str, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    code, shown = call(capsys, "apply", "points.npy", "--edit", "edit.json", *words)
    assert code == 2
    assert expected in shown


def test_a_list_of_edits(folder: Path, capsys: pytest.CaptureFixture[str]):
    edit = write_edit(
        folder, {**SHIFT, "region": LOW, "freeze": [LOW]}, {"type": "scale", "factor": 2}
    )
    code, shown = call(capsys, "list", edit)
    assert code == 0
    first, second = shown.splitlines()
    assert first.startswith("1. rigid: ")
    assert "; in a half_space (falloff 1.2" in first
    assert "; not in a half_space" in first
    assert second.startswith("2. scale: ")
    write_edit(folder, {"type": "scale", "factor": {"keyframes": [[1, 2], [5, 4]]}})
    _, shown = call(capsys, "list", edit)
    assert "factor 2.0" in shown
    assert "animated from time 1 to 5; shown at the start" in shown
    write_edit(folder)
    assert call(capsys, "list", edit) == (0, "no edit\n")


def test_validating(folder: Path, capsys: pytest.CaptureFixture[str]):
    edit = folder / "edit.json"
    assert call(capsys, "validate", edit) == (0, f"{edit}: valid, 1 edit\n")
    code, shown = call(capsys, "validate", edit, "--run", folder / "run")
    assert code == 0
    assert "valid, 1 edit; fits the 40 points of" in shown
    write_edit(folder, {**SHIFT, "region": {"shape": "points", "ids": [40]}})
    assert call(capsys, "validate", edit)[0] == 0
    code, shown = call(capsys, "validate", edit, "--run", folder / "run")
    assert code == 2
    assert "expected numbers from 0 to 39" in shown
    write_edit(folder, {"type": "shear"})
    assert call(capsys, "validate", edit)[0] == 2


def test_validating_looks_at_all_keys_and_between(folder: Path, capsys: pytest.CaptureFixture[str]):
    # A bend by 300 degrees folds; it is reached in the middle, and at a key of its own.
    for keys in ([[0, 0], [1, 300], [2, 0]], [[0, -300], [1, 300]]):
        angle = {"keyframes": keys, "easing": "smooth"}
        bend = {"type": "bend", "axis": "z", "angle_deg": angle, "limits": [0.4, 0.6]}
        edit = write_edit(folder, bend)
        code, shown = call(capsys, "validate", edit, "--run", folder / "points.npy")
        assert code == 2
        assert "at time" in shown
        assert "singular deformation" in shown
    move = {
        "shape": "sphere",
        "center": {"keyframes": [[0, [0, 0, 1]], [1, [0, 0, -1]]]},
        "radius": 0.3,
    }
    edit = write_edit(folder, {**SHIFT, "translation": [0, 0, 0.001], "region": move})
    words = ["validate", edit, "--run", folder / "points.npy"]
    code, shown = call(capsys, *words, "--frames", 2)
    assert code == 0
    assert "times checked: 2" in shown
    # At both ends the ball holds a piece of the shell, in the middle nothing.
    code, shown = call(capsys, *words)
    assert code == 2
    assert "empty region" in shown


def test_points_outside_a_cage_are_warned_of(folder: Path, capsys: pytest.CaptureFixture[str]):
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=1.2)
    mesh.vertices[:, 2] += 0.5
    mesh.export(folder / "cage.ply")
    cage = {"type": "cage", "before": "cage.ply", "after": "cage.ply"}
    cage["amount"] = {"keyframes": [[0, 0], [1, 1]]}
    edit = write_edit(folder, cage)
    code, shown = call(capsys, "validate", edit, "--run", folder / "points.npy", "--frames", 3)
    assert code == 0
    assert shown.count("warning: edit 1 (cage): ") == 1
    assert "of 300 points lie outside the cage" in shown
    output = folder / "moved.npy"
    words = [folder / "points.npy", "--edit", edit, "-o", output, "--time", 1]
    assert "of 300 points lie outside the cage" in call(capsys, "apply", *words)[1]
    mesh.vertices[:, 2] += 5
    mesh.export(folder / "cage.ply")
    code, shown = call(capsys, "validate", edit, "--run", folder / "points.npy")
    assert code == 2
    assert "holds none of the 300 points" in shown
