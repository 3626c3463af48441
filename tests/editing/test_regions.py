"""Regions, frozen regions and parts in the edit file."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from pcore.deform.weighted import Held
from pcore.editing.reading import parse_region
from pcore.editing.regions import Setting, bind_region
from pcore.editing.script import EditScript, load_edit, parse_edit
from pcore.editing.session import EditSession
from pcore.editing.widening import widened
from pcore.errors import EditError

SPHERE = {"shape": "sphere", "center": [0.3, 0, 0], "radius": 0.15, "falloff": 0.2}
# Small against the seams, so that nothing folds.
STEP = 0.02
SHIFT = {"type": "rigid", "translation": [0, 0, STEP]}
REGIONS = {
    "box": {"shape": "box", "lower": [0, -1, -1], "upper": [1, 1, 1]},
    "sphere": SPHERE,
    "half_space": {"shape": "half_space", "normal": "x", "falloff": 0.2},
    "points": {"shape": "points", "ids": [3, 1, 4]},
    "geodesic": {"shape": "geodesic", "center": [0.3, 0, 0], "radius": 0.2},
    "mask": {"shape": "mask", "file": "mask.npy"},
}


def cloud() -> torch.Tensor:
    return torch.rand(500, 3, generator=torch.Generator().manual_seed(2)) - 0.5


def script(*edits: dict, **more) -> EditScript:
    return parse_edit({"version": 2, "edits": list(edits), **more}, source="edit.json")


def message(*edits: dict, **more) -> str:
    with pytest.raises(EditError) as caught:
        script(*edits, **more)
    return str(caught.value)


def bind_message(*edits: dict, **more) -> str:
    made = script(*edits, **more)
    with pytest.raises(EditError) as caught:
        made.bind(cloud())
    return str(caught.value)


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with masks as the working directory, where relative paths begin."""
    monkeypatch.chdir(tmp_path)
    np.save("mask.npy", cloud()[:, 0].numpy() > 0.2)
    np.save("weights.npy", (cloud()[:, 0].numpy() + 0.5).clip(0, 1))
    return tmp_path


@pytest.mark.parametrize("name", REGIONS)
def test_every_region_moves_some_and_leaves_others(name: str):
    points = cloud()
    moved = script({**SHIFT, "region": REGIONS[name]}).bind(points)(points)
    way = (moved - points)[:, 2]
    assert float(way.max()) == pytest.approx(STEP, rel=1e-4)
    assert bool((way == 0).any())
    assert bool(((way > 0.05 * STEP) & (way < 0.95 * STEP)).any())


@pytest.mark.parametrize("name", REGIONS)
@pytest.mark.parametrize("top", [True, False])
def test_what_is_frozen_moves_by_exactly_zero(name: str, top: bool):
    points = cloud()
    edits = [SHIFT, {"type": "twist", "axis": "z", "angle_deg": 1}]
    setting = Setting(points=points.double(), rest=points.double())
    region = bind_region(parse_region(REGIONS[name], None), setting)
    inside = region.weight(points.double()) == 1
    assert int(inside.sum()) > 0
    if top:
        bound = script(*edits, freeze=[REGIONS[name]]).bind(points)
    else:
        bound = script({**edits[0], "freeze": [REGIONS[name]]}).bind(points)
    assert torch.equal(bound(points)[inside], points[inside])
    double = points.double()
    assert torch.equal(bound(double)[inside], double[inside])
    assert bool((bound(points)[~inside] != points[~inside]).any())


def test_freezing_wins_over_the_region_of_an_edit():
    points = cloud()
    both = script({**SHIFT, "region": REGIONS["half_space"], "freeze": [SPHERE]}).bind(points)
    near = (points - torch.tensor([0.3, 0, 0])).norm(dim=-1) < 0.149
    assert torch.equal(both(points)[near], points[near])
    assert bool((both(points)[points[:, 0] > 0] != points[points[:, 0] > 0]).any())


def test_a_frozen_region_of_the_file_is_meant_where_the_object_was():
    """The first edit carries other points into the region and its own points are out of it."""
    points = cloud()
    edits = [SHIFT, {**SHIFT, "translation": [0, 0, -1]}]
    edits[0] = {**SHIFT, "translation": [0, 0, 2]}
    moved = script(*edits, freeze=[{**SPHERE, "falloff": 0}]).bind(points)(points)
    inside = (points - torch.tensor([0.3, 0, 0])).norm(dim=-1) < 0.15
    assert torch.equal(moved[inside], points[inside])
    expected = points[~inside] + torch.tensor([0.0, 0, 1])
    torch.testing.assert_close(moved[~inside], expected)


def test_a_region_of_an_edit_is_meant_where_the_points_arrive():
    points = cloud()
    there = {"shape": "half_space", "origin": [10, 0, 0], "normal": "x", "falloff": 0}
    far = {**SHIFT, "translation": [10, 0, 0]}
    moved = script(far, {**SHIFT, "region": there}).bind(points)(points)
    right = points[:, 0] > 0
    torch.testing.assert_close(moved[right][:, 2], points[right][:, 2] + STEP)
    torch.testing.assert_close(moved[~right][:, 2], points[~right][:, 2])


def test_paths_are_those_of_the_object_before_the_edits():
    """Two halves pushed into each other stay two halves for a geodesic ball."""
    points = cloud()
    points[:, 0] += torch.where(points[:, 0] > 0, 5.0, -5.0)
    together = [
        {**SHIFT, "translation": [-4.9, 0, 0], "region": {"shape": "half_space", "normal": "x"}},
        {
            **SHIFT,
            "translation": [4.9, 0, 0],
            "region": {"shape": "half_space", "normal": [-1, 0, 0], "origin": [-4, 0, 0]},
        },
    ]
    middle = script(*together).bind(points)(points)
    assert float(middle[:, 0].abs().max()) < 0.61
    ball = {"shape": "geodesic", "center": [0.11, 0, 0], "radius": 1.5, "falloff": 0}
    moved = script(*together, {**SHIFT, "region": ball}).bind(points)(points)
    right = points[:, 0] > 0
    assert float((moved - middle)[right][:, 2].mean()) > 0.95 * STEP
    assert float((moved - middle)[~right][:, 2].abs().max()) == 0


def test_a_part_turns_and_grows_about_its_own_centre():
    points = cloud().double()
    region = {"shape": "half_space", "origin": [0.1, 0, 0], "normal": "x", "falloff": 0}
    inside = points[:, 0] > 0.1
    part = {"type": "part", "region": region, "axis": "z", "angle_deg": 90, "factor": 2}
    moved = script(part).bind(points)(points)
    torch.testing.assert_close(moved[inside].mean(dim=0), points[inside].mean(dim=0))
    torch.testing.assert_close(torch.pdist(moved[inside]), 2 * torch.pdist(points[inside]))
    assert torch.equal(moved[~inside], points[~inside])
    fixed = {**part, "origin": [0.5, 0, 0], "translation": [0, 0, 3]}
    moved = script(fixed).bind(points)(points)
    at = points[inside] - torch.tensor([0.5, 0, 0])
    expected = torch.stack([0.5 - 2 * at[:, 1], 2 * at[:, 0], 2 * at[:, 2] + 3], dim=-1)
    torch.testing.assert_close(moved[inside], expected)


def test_round_trip_with_files_named_from_the_edit_file(tmp_path: Path):
    edits = [
        {**SHIFT, "region": REGIONS["mask"], "freeze": [SPHERE]},
        {"type": "part", "region": REGIONS["geodesic"], "axis": "x", "angle_deg": 10},
    ]
    made = script(*edits, freeze=[REGIONS["points"], REGIONS["mask"]])
    made.save("edit.json")
    saved = json.loads(Path("edit.json").read_text())
    assert saved["version"] == 2
    assert saved["edits"][0]["region"]["file"] == "mask.npy"
    assert saved["freeze"][1] == {"shape": "mask", "file": "mask.npy"}
    again = load_edit(tmp_path / "edit.json")
    assert again == made
    assert again.to_json() == made.to_json()
    assert torch.equal(again.bind(cloud())(cloud()), made.bind(cloud())(cloud()))
    # From elsewhere the file keeps its whole name.
    (tmp_path / "other").mkdir()
    made.save("other/edit.json")
    assert load_edit("other/edit.json") == made


def test_scripts_differ_by_what_they_freeze():
    assert script(SHIFT) != script(SHIFT, freeze=[SPHERE])
    assert script(SHIFT) == script({**SHIFT, "freeze": []}, freeze=[])


@pytest.mark.parametrize(
    ("region", "expected"),
    [
        (7, 'key "region": expected a region {"shape": "box" or'),
        ({}, 'key "region": key "shape": expected one of "box", "sphere"'),
        ({"shape": "cone"}, 'got "cone"'),
        ({"shape": "sphere", "center": [0, 0, 0]}, 'key "radius": expected a length of 0 or more'),
        (
            {**SPHERE, "radius": -1},
            'key "radius": expected a length of 0 or more, world units, got',
        ),
        ({**SPHERE, "falloff": -1}, 'key "falloff": expected a length of 0 or more over which'),
        (
            {**SPHERE, "center": [0, 0, float("nan")]},
            "three finite numbers [x, y, z], got [0, 0, N",
        ),
        ({**SPHERE, "size": 1}, 'unknown key "size" for a sphere, expected only "falloff", "cen'),
        ({"shape": "half_space", "normal": [0, 0, 0]}, 'key "normal": expected "x", "y", "z" or a'),
        ({"shape": "box", "lower": [0, 0, 1], "upper": [1, 1, 0]}, '"lower": expected no number a'),
        ({"shape": "points", "ids": []}, 'key "ids": expected a list of point numbers from 0'),
        ({"shape": "points", "ids": [1.5]}, "expected a list of point numbers from 0, at least"),
        ({"shape": "points", "ids": [-1]}, "expected a list of point numbers from 0, at least"),
        ({"shape": "mask", "file": ""}, 'key "file": expected the path of a .npy file, got ""'),
    ],
)
def test_bad_regions(region: object, expected: str):
    text = message({**SHIFT, "region": region})
    assert text.startswith("edit.json: edit 1 (rigid): ")
    assert expected in text
    text = message(SHIFT, freeze=[SPHERE, region])
    assert text.startswith('edit.json: key "freeze", region 2: ')


def test_freeze_is_a_list():
    assert 'expected a list of regions, got {"shape"' in message(SHIFT, freeze=SPHERE)
    assert 'key "freeze": expected a list' in message({**SHIFT, "freeze": SPHERE})
    assert '(part): key "region": expected a region' in message({"type": "part"})
    assert 'part): "axis": expected "x", "y", "z"' in message(
        {"type": "part", "region": SPHERE, "angle_deg": 3}
    )


@pytest.mark.parametrize(
    ("region", "expected"),
    [
        ({**SPHERE, "center": [9, 9, 9]}, "empty region: expected the sphere to hold at least one"),
        ({"shape": "points", "ids": [0, 500, 777]}, "expected numbers from 0 to 499 because there"),
        ({"shape": "points", "ids": [0, 500, 777]}, "got 500, 777; numbers belong to one model"),
        ({"shape": "mask", "file": "none.npy"}, "none.npy: no such file"),
        ({"shape": "mask", "file": "mask.txt"}, "mask.txt: expected a NumPy array in a .npy file"),
        ({"shape": "mask", "file": "short.npy"}, "expected a mask of 500 values, one for each poi"),
        ({"shape": "mask", "file": "empty.npy"}, "expected a mask that holds a point, got none"),
        ({"shape": "mask", "file": "nan.npy"}, "numbers between 0 and 1, got float64 beyond them"),
        ({"shape": "mask", "file": "numbers.npy"}, "between 0 and 1, got int64"),
        ({"shape": "mask", "file": "zero.npy"}, "empty region: expected the mask to hold"),
        (
            {"shape": "mask", "file": "weights.npy", "falloff": 0.1},
            'expected no "falloff" for a mask of weights',
        ),
    ],
)
def test_regions_that_do_not_fit_the_points(region: dict, expected: str):
    np.save("short.npy", np.ones(3, dtype=bool))
    np.save("empty.npy", np.zeros(500, dtype=bool))
    np.save("zero.npy", np.zeros(500))
    np.save("numbers.npy", np.ones(500, dtype=np.int64))
    np.save("nan.npy", np.full(500, np.nan))
    text = bind_message({**SHIFT, "region": region})
    assert text.startswith("edit.json: edit 1 (rigid): ")
    assert expected in text
    text = bind_message(SHIFT, freeze=[region])
    assert text.startswith("edit.json: freeze: ")
    assert expected in text


def test_weights_of_a_mask_are_taken_as_they_are():
    points = cloud()
    region = {"shape": "mask", "file": "weights.npy"}
    moved = script({**SHIFT, "region": region}).bind(points)(points)
    expected = STEP * (points[:, 0] + 0.5).clamp(0, 1)
    torch.testing.assert_close((moved - points)[:, 2], expected, rtol=0, atol=1e-6)


def test_a_fold_in_a_seam_names_the_points():
    points = cloud()
    thin = {"shape": "half_space", "normal": "x", "falloff": 0.2}
    over = {"type": "rigid", "translation": [-0.3, 0, 0], "region": thin}
    text = bind_message(over)
    seam = [n for n, x in enumerate(points[:, 0].tolist()) if -0.2 < x < 0]
    assert "singular deformation" in text
    first = int(text.split("(numbers ")[1].split(",")[0])
    assert first in seam
    assert "the falloff of the region" in text
    away = {**over, "region": None, "translation": [0, 0, 0.5]}
    assert "(numbers " in bind_message(away, freeze=[SPHERE])
    assert isinstance(script(SHIFT, freeze=[SPHERE]).bind(points), Held)


def test_many_edits_are_as_good_as_the_one_they_make():
    points = cloud().double()
    twist = {"type": "twist", "axis": "z", "angle_deg": 6, "extent": [-0.5, 0.5]}
    many = script(*[twist] * 10).bind(points)(points)
    whole = script({**twist, "angle_deg": 60}).bind(points)(points)
    torch.testing.assert_close(many, whole, rtol=0, atol=1e-14)


def test_a_dragged_hand_leaves_the_rest_of_the_knight_alone(shared_data: Path):
    path = shared_data / "deformed" / "knight" / "meshes.npz"
    if not path.is_file():
        pytest.skip(f"{path} is absent")
    with np.load(path) as arrays:
        corners = arrays["canonical"][arrays["faces"][arrays["sample_face"]]]
        places = (arrays["sample_barycentric"][..., None] * corners).sum(axis=1)
        points = torch.from_numpy(places[arrays["sample_visible"]][::8]).float()
    size = float((points.amax(dim=0) - points.amin(dim=0)).norm())
    hand = points[points[:, 0].argmax()]
    ball = {"shape": "geodesic", "center": hand.tolist(), "radius": 0.1 * size}
    part = {"type": "part", "region": {**ball, "falloff": 0.2 * size}}
    moved = script({**part, "translation": [0, 0, 0.05 * size]}).bind(points)(points)
    way = (moved - points).norm(dim=-1)
    assert float(way.max()) == pytest.approx(0.05 * size, rel=1e-3)
    far = (points - hand).norm(dim=-1) > 0.4 * size
    assert int(far.sum()) > 1000
    assert float(way[far].max()) <= 0.01 * size


def test_a_region_that_holds_points_in_its_seam_only_is_empty():
    beside = {"shape": "sphere", "center": [0.9, 0, 0], "radius": 0.1, "falloff": 0.6}
    text = bind_message({**SHIFT, "region": beside})
    assert (
        "empty region: expected the sphere to hold at least one of the 500 points, got none ("
        in text
    )
    assert "lie in its seam, where it fades); move it or make it larger" in text
    text = bind_message({**SHIFT, "region": {**beside, "center": [9, 0, 0]}})
    assert "got none; move it or make it larger" in text
    # The weights of a mask of numbers are meant as they are, though none is 1.
    np.save("weights.npy", np.full(500, 0.5))
    script({**SHIFT, "region": {"shape": "mask", "file": "weights.npy"}}).bind(cloud())
    np.save("weights.npy", np.zeros(500))
    text = bind_message({**SHIFT, "region": {"shape": "mask", "file": "weights.npy"}})
    assert "empty region: expected the mask to hold" in text


def test_a_geodesic_ball_far_from_the_object_is_refused():
    far = {"shape": "geodesic", "center": [5, 0, 0], "radius": 3}
    text = bind_message({**SHIFT, "region": far})
    assert 'key "center": expected a place on the object, got [5.0, 0.0, 0.0], which is 4.5' in text
    assert "from the nearest point (object size 1.7" in text
    assert "at most 15% of it); is it in world units?" in text
    near = {**far, "center": [0.6, 0, 0], "radius": 0.2}
    script({**SHIFT, "region": near}).bind(cloud())


def test_the_next_falloff_that_does_not_fold_is_found():
    points = torch.rand(400, 3, generator=torch.Generator().manual_seed(2)) - 0.5
    low = {"shape": "half_space", "origin": [0, 0, -0.1], "normal": [0, 0, -1], "falloff": 0.1}
    push = {"type": "rigid", "translation": [0, 0, -0.2]}
    session = EditSession(points)
    session.freeze(low)
    with pytest.raises(EditError, match="widen the falloff"):
        session.do(push)
    found = widened(session, push)
    # A quintic falls by 1.875 of its height per length at most.
    assert 0.8 * 0.2 * 1.875 < found.falloff < 1.25 * 0.2 * 1.875
    session.freeze(*found.freeze)
    state = session.do(found.edit)
    assert torch.equal(state.points[points[:, 2] < -0.1], points[points[:, 2] < -0.1])
    own = widened(EditSession(points), {**push, "freeze": [low]})
    assert own.freeze == ()
    assert own.falloff == found.falloff
    assert EditSession(points).do(own.edit).script.edits[0].freeze[0].falloff == own.falloff
    with pytest.raises(EditError, match="lower the amount"):
        widened(EditSession(points), {"type": "bend", "axis": "z", "angle_deg": 400})
