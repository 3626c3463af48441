"""States of `pcore benchmark make`: their names, their places, and the bend's axis."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from figure_model import TURN, bar, bowed, figure
from gltf_files import Builder

from pcore.asset.posing import script_of
from pcore.benchmark.long_triangles import long_triangles
from pcore.benchmark.making import SPLITS
from pcore.benchmark.model import read_model
from pcore.benchmark.model_states import (
    BenchmarkPlan,
    State,
    canonical_shape,
    formulas,
    plan_states,
)
from pcore.cli.main import main
from pcore.errors import InputError
from pcore.evaluation.deformation_record import DeformationRecord
from pcore.evaluation.states import open_states
from pcore.sample.sample_render import camera_poses
from pcore.sample.sample_states import ANGLE_X


def save(made: Builder, folder: Path) -> Path:
    path = folder / "figure.glb"
    path.write_bytes(made.content())
    return path


def make(*words: object) -> int:
    sizes = ["--size", 24, "--train-views", 2, "--test-views", 1]
    return main(["benchmark", "make", *map(str, [*words, *sizes])])


def test_times_of_one_clip_and_clips_of_one_name_are_states_of_their_own(tmp_path: Path) -> None:
    pytest.importorskip("embreex", reason="benchmarks are ray cast with embreex")
    path, words = save(figure(), tmp_path), ["--no-analytic", "--clips", "Bow@0.5", "Bow@1.0"]
    assert make(path, "-o", tmp_path / "out", *words) == 0
    states = open_states(tmp_path / "out")
    assert states.names == ("bow_0_5", "bow_1")
    record = json.loads((tmp_path / "out" / "scene.json").read_text())["states"]
    assert [record[name]["time"] for name in states.names] == [0.5, 1.0]
    twins = figure()
    twins.tree["animations"][1]["name"] = "Bow"
    assert [one.name for one in read_model(save(twins, tmp_path)).clips] == ["Bow", "Bow 2"]


def states_of(path: Path, **words: Any) -> tuple[dict[str, State], list[str]]:
    model, plan = read_model(path), BenchmarkPlan(**words)
    return plan_states(model, plan, *canonical_shape(model, plan))


def test_parents_that_scale_unevenly_shear_what_turns_below_them(tmp_path: Path) -> None:
    """Global matrices are products, as the standard says and Blender does (to 3e-7 of the size)."""
    made, place = figure(), bar()[0]
    made.tree["nodes"] += [{"children": [1], "scale": [2.0, 1.0, 0.5]}]
    made.tree["scenes"] = [{"nodes": [0, 3]}]
    model = read_model(save(made, tmp_path))
    moved = bowed(place, TURN) * (2.0, 1.0, 0.5)
    expected = np.stack([moved[:, 0], -moved[:, 2], moved[:, 1]], axis=1)
    np.testing.assert_allclose(model.at(model.clip("Bow"), 2.0), expected, atol=2e-7)


@pytest.mark.parametrize("name", ["Canonical", "Faces", "train geometry", "Sample face", "test"])
def test_no_clip_takes_a_name_of_the_benchmark(tmp_path: Path, name: str) -> None:
    made = figure()
    made.tree["animations"][0]["name"] = name
    states, notes = states_of(save(made, tmp_path), analytic=False)
    (state,) = states
    assert state == "state_" + name.lower().replace(" ", "_")
    assert f"the clip {name!r} at 2 s is the state {state!r}" in notes[-1]


def test_a_clip_that_walks_out_of_sight_stays_in_the_pictures(tmp_path: Path) -> None:
    made = figure()
    walk = made.tree["animations"][1]
    walk["channels"][0]["target"] = {"node": 1, "path": "translation"}
    walk["samplers"][0]["output"] = made.array(np.array([[0, 0, 0], [9.0, 0, 0]]))
    path = save(made, tmp_path)
    states, notes = states_of(path, analytic=False, clips=(("Stay", 2.0),), every_clip=False)
    before = canonical_shape(read_model(path), BenchmarkPlan())[0]
    assert np.abs(states["stay"].vertices - before).max() < 1e-6
    away = states["stay"].description["removed_motion"]
    assert np.linalg.norm(away) == pytest.approx(
        9 * canonical_shape(read_model(path), BenchmarkPlan())[2]
    )
    assert "leaves the cameras' sight" in notes[-1]
    (tmp_path / "far.json").write_text(
        '{"version": 2, "edits": [{"type": "scale", "factor": 3.5}]}'
    )
    with pytest.raises(InputError, match=r"within 2.8 radii.*reaches 3\.50"):
        states_of(path, edits=(("far", script_of(tmp_path / "far.json")),))


def test_a_state_that_has_shrunk_is_told(tmp_path: Path) -> None:
    made = figure()
    fade = made.tree["animations"][1]
    fade["channels"][0]["target"] = {"node": 1, "path": "scale"}
    fade["samplers"][0]["output"] = made.array(np.array([[1.0, 1, 1], [0, 0, 0]]))
    (tmp_path / "tiny.json").write_text(
        '{"version": 2, "edits": [{"type": "scale", "factor": 0.1}]}'
    )
    edits = (("tiny", script_of(tmp_path / "tiny.json")),)
    path = save(made, tmp_path)
    _, notes = states_of(path, analytic=False, edits=edits)
    assert [note.split(" of the")[0] for note in notes] == [
        "the state 'tiny' has shrunk to 10 %",
        "the state 'stay' has shrunk to 4 %",
    ]
    assert states_of(path, analytic=False, clips=(("Stay", 1.0),), every_clip=False)[1] == []


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_bend_about_a_chosen_axis_is_its_formula(tmp_path: Path, axis: Any) -> None:
    states, _ = states_of(save(figure(), tmp_path), bend_axis=axis, every_clip=False)
    formula = DeformationRecord.model_validate(states["bend60"].description).deformation()
    assert formula is not None
    before = canonical_shape(read_model(tmp_path / "figure.glb"), BenchmarkPlan())[0]
    moved = formula(torch.from_numpy(before)).numpy()
    assert np.abs(moved - states["bend60"].vertices).max() < 1e-12
    kept = "xyz".index(axis)
    assert np.abs(moved[:, kept] - before[:, kept]).max() < 1e-12
    assert np.abs(moved - before).max() > 0.02


@pytest.mark.parametrize(("name", "axis"), [("knight", "y"), ("robot", "x")])
def test_the_evaluation_set_is_made_again(shared_data: Path, name: str, axis: Any) -> None:
    """Poses are the same; maps are, to the single precision of the set's meshes."""
    folder = shared_data / "deformed" / name
    for split, place in SPLITS.items():
        frames = json.loads((folder / f"transforms_{split}.json").read_text())["frames"]
        known = np.array([one["transform_matrix"] for one in frames])
        assert np.abs(known - camera_poses(len(known), **place)).max() < 1e-12
    with np.load(folder / "meshes.npz") as meshes:
        vertices = meshes["canonical"].astype(float)
        for state, one in formulas(vertices, axis).items():
            moved = one.deformation(torch.from_numpy(vertices)).numpy()
            assert np.abs(moved - meshes[state]).max() < 3e-7


def test_info_lists_what_clips_there_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(save(figure(), tmp_path))]) == 0
    told = capsys.readouterr().out
    assert "117 vertices, 192 triangles" in told
    assert "Bow: 0 to 2 seconds" in told
    assert "1, 1 with a texture" in told


def test_triangles_too_long_for_a_map_are_told(tmp_path: Path) -> None:
    # One ring of a bar: between its ends nothing can turn. An edge across a face turns by 30
    # degrees at rest and by 60 more in the state: its middle goes to r cos 15, the edge's is at
    # r cos 45.
    _, notes = states_of(save(figure(rings=1), tmp_path), resolution=100)
    off = 0.2 / np.hypot(1, 0.2) * (np.cos(np.radians(15)) - np.cos(np.radians(45)))
    pixels = off / (8 * np.tan(0.5 * ANGLE_X) / 100)
    (said,) = (note for note in notes if "subdivide" in note)
    assert f"twist60 {pixels:.1f} pixels, 100 % of the surface" in said
    assert "bend60" in said
    assert "scale2x" not in said
    assert "bow" not in said  # What a file shows of its clips is the truth.
    _, notes = states_of(save(figure(rings=48), tmp_path), resolution=100)
    assert not any("subdivide" in note for note in notes)


def test_pixels_of_long_triangles_are_those_of_the_states_pictures() -> None:
    """A state that is larger is seen from a wider angle, so that its pixels are larger, too."""
    place, _, faces = bar(1, 12)
    vertices, faces = place.astype(float), faces.astype(np.int64)
    twist = formulas(vertices, None)["twist60"].deformation
    maps = {"near": twist, "far": twist}
    (said,) = long_triangles(vertices, faces, maps, {"near": 0.01, "far": 0.02})
    near, far = (float(one) for one in re.findall(r"(?:near|far) ([\d.]+) pixels", said))
    assert near == pytest.approx(2 * far, abs=0.15)
    assert "edits `mesh` and `displacement`" in said
