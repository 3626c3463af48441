"""Keyframes: values over time, and what is said about bad ones."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from pcore.editing.animation import Animation, load_animation
from pcore.editing.script import load_edit, parse_edit
from pcore.errors import EditError, InputError


def track(*keys: list, **more) -> dict:
    return {"keyframes": list(keys), **more}


def animation(angle: object, **more) -> Animation:
    edit = {"type": "twist", "axis": "z", "angle_deg": angle}
    return Animation({"version": 2, "edits": [edit], **more}, source="edit.json")


def angle_at(made: Animation, time: float) -> float:
    return made.at(time).edits[0].angle_deg


@pytest.mark.parametrize(
    ("easing", "quarter"),
    [("linear", 15.0), ("smooth", 60 * 0.15625), ("in", 3.75), ("out", 26.25), ("step", 0.0)],
)
def test_easings(easing: str, quarter: float):
    made = animation(track([1, 0], [3, 60], easing=easing))
    assert angle_at(made, 1.5) == pytest.approx(quarter)
    assert [angle_at(made, time) for time in (0, 1, 3, 9)] == [0, 0, 60, 60]
    assert angle_at(animation(track([1, 0], [3, 60])), 2) == 30


def test_several_keys_and_several_tracks():
    hand = {"shape": "sphere", "center": track([0, [0, 0, 0]], [4, [0, 0, 2]]), "radius": 1}
    made = Animation(
        {
            "version": 2,
            "freeze": [{**hand, "radius": track([0, 1], [8, 2])}],
            "edits": [
                {"type": "twist", "axis": "z", "angle_deg": track([1, 0], [2, 10], [4, -10])},
                {"type": "rigid", "translation": [0, 0, 1], "region": hand},
            ],
        }
    )
    assert (made.start, made.end) == (0, 8)
    assert made.times(5) == [0, 2, 4, 6, 8]
    assert made.times(1) == [0]
    still = made.at(3)
    assert still.edits[0].angle_deg == 0
    assert still.edits[1].region.center == (0, 0, 1.5)
    assert still.freeze[0].radius == pytest.approx(1.375)
    assert still.freeze[0].center == (0, 0, 1.5)


def test_a_still_edit_is_an_animation_too():
    made = animation(40)
    assert (made.start, made.end) == (0, 0)
    assert made.times(3) == [0, 0, 0]
    assert made.at(7) == parse_edit(
        {"version": 2, "edits": [{"type": "twist", "axis": "z", "angle_deg": 40}]}
    )


def test_at_a_time_it_is_an_edit_file_without_keyframes(tmp_path: Path):
    content = {
        "version": 2,
        "edits": [{"type": "scale", "factor": track([0, 1], [1, 3])}],
    }
    (tmp_path / "edit.json").write_text(json.dumps(content))
    half = load_animation(tmp_path / "edit.json").at(0.5)
    half.save(tmp_path / "half.json")
    points = torch.rand(20, 3)
    torch.testing.assert_close(load_edit(tmp_path / "half.json").bind(points)(points), 2 * points)
    with pytest.raises(EditError, match="expected an edit that stands still, got one with keyf"):
        load_edit(tmp_path / "edit.json")


def test_what_is_given_can_be_changed_afterwards():
    data = {"version": 2, "edits": [{"type": "scale", "factor": track([0, 1], [1, 3])}]}
    made = Animation(data)
    data["edits"].clear()
    assert made.at(1).edits[0].factor == 3


@pytest.mark.parametrize("time", [math.nan, math.inf])
def test_times_that_are_none(time: float):
    with pytest.raises(EditError, match=f"expected a finite time, got {time}"):
        Animation({"version": 2, "edits": []}).at(time)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (track([1, 0], [1, 5]), "keyframe 2: expected keyframes in order, each later than the one"),
        (track([2, 0], [1, 5]), "got the time 1 after 2"),
        (track(), "expected keyframes "),
        ({"keyframes": 3}, "at least one, got 3"),
        (track([0, 0], [1]), "keyframe 2: expected [time, value] with a finite time and a number"),
        (track([0, "a"]), "keyframe 1: expected [time, value]"),
        (track([float("nan"), 1]), "keyframe 1: expected [time, value]"),
        (track([0, float("nan")]), "keyframe 1: expected [time, value]"),
        (track([0, 1], [1, [1, 2]]), "keyframe 2: expected a value of the same kind as the first"),
        (track([0, 1], easing="bounce"), 'expected an "easing" that is one of "linear", "smooth"'),
        (track([0, 1], ease="in"), 'expected only "keyframes" and "easing" beside each other'),
        (track([0, [1, 2]]), 'at time 0: edit 1 (twist): key "angle_deg": expected a finite'),
    ],
)
def test_bad_keyframes(value: object, expected: str):
    with pytest.raises(EditError) as caught:
        animation(value)
    assert str(caught.value).startswith("edit.json")
    assert expected in str(caught.value)


def test_where_a_bad_track_is():
    with pytest.raises(EditError, match=r'edit.json: edit 1: key "angle_deg": keyframe 2: expec'):
        animation(track([1, 0], [0, 5]))
    ball = {"shape": "sphere", "center": [0, 0, 0], "radius": track([1, 0], [0, 5])}
    with pytest.raises(EditError, match=r'edit.json: freeze: key "radius": keyframe 2: expected'):
        animation(3, freeze=[ball])


def test_a_value_that_only_some_frames_have_is_checked_at_the_keys():
    data = {"version": 2, "edits": [{"type": "scale", "factor": track([0, 1], [1, -1])}]}
    with pytest.raises(EditError, match=r'at time 1: edit 1 .scale.: key "factor": expected a fin'):
        Animation(data)


def test_a_film_has_a_frame():
    with pytest.raises(InputError, match="frames: expected a whole number of at least 1, got 0"):
        animation(3).times(0)


def test_saving_keeps_keyframes_and_renames_files(tmp_path: Path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "other").mkdir()
    mask = {"shape": "mask", "file": "mask.npy"}
    edits = [
        {
            "type": "displacement",
            "before": "a.npy",
            "after": "b.npy",
            "amount": track([0, 0], [1, 1]),
        },
        {"type": "cage", "before": "../c.ply", "after": [[0.0, 1.0, 2.0]], "region": mask},
    ]
    (tmp_path / "sub" / "edit.json").write_text(json.dumps({"version": 2, "edits": edits}))
    made = load_animation(tmp_path / "sub" / "edit.json")
    for folder in ("other", ".", "sub"):
        made.save(tmp_path / folder / "new.json")
        again = load_animation(tmp_path / folder / "new.json")
        assert again.key_times == (0, 1)
        for time in (0, 0.5, 1):
            then = [edit.model_dump() for edit in again.at(time).edits]
            assert then[0]["before"] == str(tmp_path / "sub" / "a.npy")
            assert then[0]["amount"] == time
            assert Path(then[1]["before"]).resolve() == tmp_path / "c.ply"
            assert then[1]["region"]["file"] == str(tmp_path / "sub" / "mask.npy")
    text = json.loads((tmp_path / "new.json").read_text())
    assert text["edits"][0]["before"] == "sub/a.npy"
    assert text["edits"][0]["amount"] == {"keyframes": [[0, 0], [1, 1]]}
    assert json.loads((tmp_path / "sub" / "new.json").read_text())["edits"][0]["before"] == "a.npy"


def test_times_that_are_checked_hold_all_keys():
    made = animation(track([0, 0], [1, 60], [3, 0]))
    assert made.times_to_check(4) == [0, 1, 2, 3]
    assert made.times_to_check(3) == [0, 1, 1.5, 3]
    assert animation(40).times_to_check(60) == [0]


@pytest.mark.parametrize("kind", ["cage", "mesh", "displacement"])
def test_keyframes_of_the_rest_shape_lead_to_the_amount(kind: str):
    edit = {"type": kind, "before": track([0, "a.ply"], [1, "b.ply"]), "after": "b.ply"}
    with pytest.raises(EditError, match=r'edit 1: key "before": .* got keyframes; .*"amount": '):
        Animation({"version": 2, "edits": [edit]})


def test_shapes_go_straight_from_key_to_key(tmp_path: Path):
    rest = torch.rand(40, 3, generator=torch.Generator().manual_seed(1)) - 0.5
    ends = {"a": rest, "b": 1.2 * rest, "c": rest + torch.tensor([0.0, 0.0, 1.0])}
    for name, points in ends.items():
        np.save(tmp_path / f"{name}.npy", points.numpy())
    edit = {
        "type": "displacement",
        "before": "a.npy",
        "after": track([0, "a.npy"], [1, "b.npy"], [2, "c.npy"], easing="smooth"),
    }
    (tmp_path / "edit.json").write_text(json.dumps({"version": 2, "edits": [edit]}))
    made = load_animation(tmp_path / "edit.json")

    def at(time: float) -> torch.Tensor:
        return made.at(time).bind(rest)(rest)

    for time, name in ((0, "a"), (1, "b"), (2, "c"), (3, "c")):
        torch.testing.assert_close(at(time), ends[name], rtol=0, atol=1e-6)
    share = 0.25**2 * (3 - 0.5)
    torch.testing.assert_close(at(1.25), torch.lerp(ends["b"], ends["c"], share), rtol=0, atol=1e-6)
    # Moved with its files, and frozen at a time, it means the same.
    (tmp_path / "far").mkdir()
    made.save(tmp_path / "far" / "edit.json")
    assert torch.equal(
        load_animation(tmp_path / "far" / "edit.json").at(0.5).bind(rest)(rest), at(0.5)
    )
    made.at(0.5).save(tmp_path / "half.json")
    assert '"first": "a.npy"' in (tmp_path / "half.json").read_text()
    assert torch.equal(load_edit(tmp_path / "half.json").bind(rest)(rest), at(0.5))


def test_the_vertices_of_a_mesh_can_be_keyed_themselves():
    first, second = [[0, 0, 1], [1, 0, 0]], [[0, 2, 1], [1, 0, 0]]
    edit = {"type": "mesh", "before": "a.ply", "after": track([0, first], [1, second])}
    made = Animation({"version": 2, "edits": [edit]})
    assert made.at(0.5).edits[0].after == ((0, 1, 1), (1, 0, 0))
    edit["after"] = track([0, first], [1, "b.ply"])
    with pytest.raises(EditError, match="expected a value of the same kind as the first"):
        Animation({"version": 2, "edits": [edit]})


def test_turns_go_the_shorter_way_round_at_one_speed():
    start, end = [2.0, 0, 0, 0], [-math.cos(0.6), 0, 0, -math.sin(0.6)]  # 1.2 radians about z.
    edit = {"type": "rigid", "rotation": track([0, start], [1, end])}
    made = Animation({"version": 2, "edits": [edit]})
    points = torch.rand(10, 3)
    for time in (0.0, 0.25, 0.5, 1.0):
        by_angle = {"type": "rigid", "axis": "z", "angle_deg": math.degrees(1.2 * time)}
        expected = parse_edit({"version": 2, "edits": [by_angle]}).bind(points)(points)
        torch.testing.assert_close(made.at(time).bind(points)(points), expected)


@pytest.mark.parametrize(
    ("turn", "said"),
    [
        ({"rotation": [0, 0, 0, 0]}, "a quaternion .w, x, y, z. of any length but 0"),
        ({"rotation": [1, 0, 0]}, "a quaternion"),
        (
            {"rotation": [1, 0, 0, 0], "axis": "z", "angle_deg": 4},
            'either a "rotation" or an "axis"',
        ),
    ],
)
@pytest.mark.parametrize("kind", ["rigid", "part", "anchors"])
def test_bad_rotations(turn: dict, said: str, kind: str):
    edit = {"type": kind, **turn}
    if kind == "part":
        edit["region"] = {"shape": "sphere", "center": [0, 0, 0], "radius": 1}
    if kind == "anchors":
        edit = {"type": kind, "handles": [{"anchor": 0, "to": [0, 0, 0], **turn}]}
    with pytest.raises(EditError, match=said):
        parse_edit({"version": 2, "edits": [edit]})
