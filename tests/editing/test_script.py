"""The edit file: what it means, and what it says when it is wrong."""

import json
import math
from pathlib import Path

import pytest
import torch
from pydantic import ValidationError

from pcore.deform.base import Affine, Compose, Identity
from pcore.deform.frame import axis_frame, bend_frame
from pcore.deform.simple import AxialStretch, Bend, Stretch, Taper, Twist, VolumeStretch
from pcore.editing.script import EditScript, check_invertible, load_edit, parse_edit
from pcore.errors import EditError

FULL = {
    "version": 2,
    "edits": [
        {"type": "twist", "axis": "x", "angle_deg": 60, "origin": [0, 0.1, 0], "lock": ["y"]},
        {"type": "bend", "axis": [1, 2, 3], "angle_deg": -20.5, "limits": [0.2, 0.8]},
        {"type": "taper", "axis": "z", "factor": 0.3, "extent": [-1, 1]},
        {"type": "stretch", "axis": "y", "factor": 0.4},
        {"type": "stretch", "axis": "y", "factor": 1, "profile": "volume"},
        {"type": "scale", "factor": 2, "origin": [1, 1, 1]},
        {"type": "rigid", "axis": "z", "angle_deg": 90, "translation": [0, 0, 1]},
    ],
}


def cloud() -> torch.Tensor:
    return torch.rand(200, 3, generator=torch.Generator().manual_seed(2)) - 0.5


def one(**edit) -> EditScript:
    return parse_edit({"version": 2, "edits": [edit]})


def message(content: object) -> str:
    with pytest.raises(EditError) as caught:
        parse_edit(content, source="edit.json")
    return str(caught.value)


def edit_message(**edit) -> str:
    return message({"version": 2, "edits": [{"type": "scale", "factor": 2}, edit]})


def test_a_twist_takes_its_extent_from_the_points():
    points = cloud()
    bound = one(type="twist", axis="x", angle_deg=60, origin=[0.1, 0, 0]).bind(points)
    assert isinstance(bound, Twist)
    along = points[:, 0].double() - 0.1
    assert bound.extent == (along.min().item(), along.max().item())
    assert bound.value == pytest.approx(math.pi / 3)
    assert torch.equal(bound.rotation, axis_frame("x"))
    assert bound.limits == (0.0, 1.0)


def test_a_bend_takes_its_extent_along_the_driving_direction():
    points = cloud()
    bound = one(type="bend", axis="x", angle_deg=30, limits=[0.25, 1]).bind(points)
    assert isinstance(bound, Bend)
    assert bound.extent == (points[:, 2].min().item(), points[:, 2].max().item())
    assert torch.equal(bound.rotation, bend_frame("x"))
    assert bound.limits == (0.25, 1.0)


def test_a_given_extent_wins_and_needs_no_points():
    script = one(type="taper", axis="z", factor=0.5, extent=[-2, 2])
    for points in (cloud(), torch.zeros(0, 3)):
        bound = script.bind(points)
        assert isinstance(bound, Taper)
        assert bound.extent == (-2.0, 2.0)
    torch.testing.assert_close(bound(torch.tensor([1.0, 1, 2])), torch.tensor([1.25, 1.25, 2]))


@pytest.mark.parametrize(
    ("profile", "kind"), [("blender", Stretch), ("axial", AxialStretch), ("volume", VolumeStretch)]
)
def test_profiles(profile: str, kind: type):
    bound = one(type="stretch", axis="y", factor=0.4, profile=profile).bind(cloud())
    assert type(bound) is kind
    assert bound.value == 0.4


@pytest.mark.parametrize("profile", ["axial", "volume"])
def test_factor_2_makes_the_extent_three_times_as_long(profile: str):
    points = cloud()
    moved = one(type="stretch", axis=[1, 1, 0], factor=2, profile=profile).bind(points)(points)
    along = [(p[:, 0] + p[:, 1]).max() - (p[:, 0] + p[:, 1]).min() for p in (points, moved)]
    assert float(along[1] / along[0]) == pytest.approx(3.0, rel=1e-5)


def test_stretch_is_blenders_by_default():
    assert isinstance(one(type="stretch", axis="y", factor=0.4).bind(cloud()), Stretch)


@pytest.mark.parametrize(
    ("axis", "lock", "expected"),
    [("x", ["y"], (True, False)), ("y", ["x"], (False, True)), ("z", ["z", "y"], (False, True))],
)
def test_lock_names_coordinates(axis: str, lock: list[str], expected: tuple[bool, bool]):
    assert one(type="twist", axis=axis, angle_deg=9, lock=lock).bind(cloud()).lock == expected


def test_scale_and_rigid():
    point = torch.tensor([2.0, 0.0, 0.0])
    scale = one(type="scale", factor=3, origin=[1, 0, 0]).bind(cloud())
    torch.testing.assert_close(scale(point), torch.tensor([4.0, 0, 0]))
    turn = {"axis": [0, 0, 2], "angle_deg": 90, "translation": [0, 0, 5], "origin": [1, 0, 0]}
    torch.testing.assert_close(
        one(type="rigid", **turn).bind(cloud())(point), torch.tensor([1.0, 1, 5])
    )
    shift = one(type="rigid", translation=[1, 2, 3]).bind(cloud())
    torch.testing.assert_close(shift(point), torch.tensor([3.0, 2, 3]))


def test_no_edits_is_the_identity():
    assert parse_edit({"version": 2, "edits": []}).bind(cloud()) == Identity()


def test_edits_act_in_order_and_each_measures_what_arrives():
    points = cloud()
    bound = parse_edit(
        {
            "version": 2,
            "edits": [
                {"type": "scale", "factor": 2},
                {"type": "twist", "axis": "z", "angle_deg": 60},
                {"type": "rigid", "translation": [0, 0, 1]},
            ],
        }
    ).bind(points)
    assert isinstance(bound, Compose)
    scale, twist, shift = bound.steps
    assert isinstance(scale, Affine)
    assert twist.extent == pytest.approx(
        (2 * points[:, 2].min().item(), 2 * points[:, 2].max().item())
    )
    torch.testing.assert_close(bound(points), shift(twist(scale(points))))


def test_binding_freezes_the_map():
    points = cloud()
    bound = one(type="bend", axis="z", angle_deg=50).bind(points)
    torch.testing.assert_close(bound(points[:1]), bound(points)[:1], rtol=0, atol=1e-6)


@pytest.mark.parametrize("single", [None, *range(7)])
def test_round_trip(tmp_path: Path, single: int | None):
    content = FULL if single is None else {"version": 2, "edits": [FULL["edits"][single]]}
    script = parse_edit(content)
    script.save(tmp_path / "edit.json")
    again = load_edit(tmp_path / "edit.json")
    assert again == script
    assert hash(again) == hash(script)
    assert again.to_json() == script.to_json()
    points = cloud()
    assert torch.equal(
        again.bind(points, allow_folds=True)(points), script.bind(points, allow_folds=True)(points)
    )
    assert [path.name for path in tmp_path.iterdir()] == ["edit.json"]


def test_json_says_all_that_was_given():
    saved = json.loads(parse_edit(FULL).to_json())
    assert saved["version"] == 2
    for given, kept in zip(FULL["edits"], saved["edits"], strict=True):
        assert given.items() <= kept.items()
        assert None not in kept.values()


def test_scripts_are_compared_by_their_edits():
    script = one(type="scale", factor=2)
    assert script == one(type="scale", factor=2.0).named("elsewhere.json")
    assert script != one(type="scale", factor=2.5)
    assert script != "a script"


def test_a_script_cannot_be_changed():
    with pytest.raises(ValidationError, match="frozen"):
        one(type="scale", factor=2).edits = ()


def test_a_byte_order_mark_is_fine(tmp_path: Path):
    path = tmp_path / "edit.json"
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(FULL).encode())
    assert len(load_edit(path).edits) == 7


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ([], 'edit.json: expected an object {"version": 2, "edits": [...]}, got []'),
        (None, "got null"),
        ({"edits": []}, 'expected "version": 2, got no such key'),
        ({"version": 3, "edits": []}, 'expected "version": 2, got 3; this pcore reads no'),
        ({"version": 1, "edits": []}, 'expected "version": 2, got 1; this pcore reads no'),
        ({"version": 2.0, "edits": []}, 'expected "version": 2, got 2.0'),
        ({"version": [2], "edits": []}, 'expected "version": 2, got [2]'),
        ({"version": "1", "edits": []}, 'expected "version": 2, got "1"'),
        ({"version": True, "edits": []}, 'expected "version": 2, got true'),
        ({"version": 2}, 'expected "edits": a list of edits, got no such key'),
        ({"version": 2, "edits": {}}, 'expected "edits": a list of edits, got {}'),
        (
            {"version": 2, "edits": [], "edit": []},
            'unknown key "edit", expected only "version", "edits" and "freeze"',
        ),
        ({"version": 2, "edits": [7]}, "edit 1: expected an object, got 7"),
    ],
)
def test_bad_scripts(content: object, expected: str):
    assert expected in message(content)


@pytest.mark.parametrize(
    ("edit", "expected"),
    [
        ({"type": "shear"}, 'key "type": expected one of "twist", "bend", "taper", "stretch", '),
        ({"type": ["twist"]}, 'got ["twist"]'),
        ({"axis": "x"}, 'key "type": expected one of'),
        ({"type": "twist", "axis": "x"}, '(twist): key "angle_deg": expected a finite number of'),
        ({"type": "bend", "angle_deg": 3}, '(bend): key "axis": expected "x", "y", "z" or'),
        ({"type": "taper", "axis": "x"}, '(taper): key "factor": expected a finite number, got no'),
        (
            {"type": "twist", "axis": "x", "factor": 2, "angle_deg": 3},
            'unknown key "factor" for a twist, expected only "region", "freeze", "name", "enabled"',
        ),
        (
            {"type": "bend", "axis": "x", "angle_deg": 3, "profile": "axial"},
            'unknown key "profile" for a bend',
        ),
        (
            {"type": "scale", "factor": 3, "axis": "x"},
            'a scale is uniform; for one direction use a stretch with profile "axial"',
        ),
        (
            {"type": "stretch", "axis": "x", "factor": 1, "profile": "cubic"},
            'key "profile": expected "blender", "axial" or "volume", got "cubic"',
        ),
        (
            {"type": "stretch", "axis": "x", "factor": -1, "profile": "axial"},
            '"factor": expected more than -1 with the profile "axial"',
        ),
        (
            {"type": "scale", "factor": 0},
            'key "factor": expected a finite number above 0 (0 is a singular deformation',
        ),
        (
            {"type": "rigid", "angle_deg": 30},
            '"axis": expected "x", "y", "z" or [x, y, z] to turn about because "angle_deg" is 30.0',
        ),
        ({"type": "rigid", "translation": [1, 2]}, 'key "translation": expected three finite'),
    ],
)
def test_bad_edits(edit: dict, expected: str):
    text = edit_message(**edit)
    assert text.startswith("edit.json: edit 2")
    assert expected in text


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("axis", [0, 0, 0], "or a non-zero vector [x, y, z] of finite numbers, got [0, 0, 0]"),
        ("axis", "w", 'key "axis": expected "x", "y", "z" or a non-zero vector'),
        ("axis", [1, 0], "got [1, 0]"),
        ("axis", [1, True, 0], "got [1, true, 0]"),
        ("axis", [1, "0", 0], 'got [1, "0", 0]'),
        ("axis", [1, float("nan"), 0], "got [1, NaN, 0]"),
        ("axis", [10**400, 0, 0], "[x, y, z] of finite numbers, got [1000"),
        ("origin", [10**400, 0, 0], "expected three finite numbers [x, y, z], got [1000"),
        ("axis", None, 'key "axis": expected "x", "y", "z" or a non-zero vector'),
        ("angle_deg", "60", 'key "angle_deg": expected a finite number of degrees, got "60"'),
        ("angle_deg", float("inf"), "expected a finite number of degrees, got Infinity"),
        ("angle_deg", True, "expected a finite number of degrees, got true"),
        ("angle_deg", 10**400, "expected a finite number of degrees, got 1000"),
        ("limits", [0.8, 0.2], "two numbers [first, second] with 0 <= first < second <= 1, got"),
        ("limits", [0.5, 0.5], "got [0.5, 0.5]"),
        ("limits", [0, 1.5], "got [0, 1.5]"),
        ("limits", [0, 0.5, 1], "got [0, 0.5, 1]"),
        ("extent", [1, -1], 'key "extent": expected two finite numbers [lo, hi] with lo < hi'),
        ("extent", [0, float("inf")], "got [0, Infinity]"),
        ("origin", [0, 0], 'key "origin": expected three finite numbers [x, y, z], got [0, 0]'),
        ("origin", [0, 0, float("nan")], "got [0, 0, NaN]"),
        ("lock", ["w"], 'key "lock": expected a list of "x", "y", "z", got ["w"]'),
        ("lock", "x", 'key "lock": expected a list of "x", "y", "z", got "x"'),
    ],
)
def test_bad_values(key: str, value: object, expected: str):
    text = edit_message(**{"type": "twist", "axis": "x", "angle_deg": 5, key: value})
    assert text.startswith("edit.json: edit 2 (twist): ")
    assert expected in text


def test_all_problems_of_an_edit_are_named():
    text = edit_message(type="twist", axis=[0, 0, 0], limits=[1, 0], angle=3)
    for key in ("axis", "limits", "angle", "angle_deg"):
        assert f'key "{key}"' in text


def test_a_tilted_axis_has_nothing_to_lock():
    text = edit_message(type="twist", axis=[1, 1, 0], angle_deg=5, lock=["x"])
    assert '"lock" needs an axis that is "x", "y" or "z", got the axis [1.0, 1.0, 0.0]' in text


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"{", "expected JSON, got text that does not parse"),
        (b"", "expected an edit file in JSON, got an empty file"),
        (b"\xff\xfe\x00", "expected text in UTF-8, got bytes that are not UTF-16"),
        (b"[" * 200_000, "text that does not parse: lists in"),
        (b'{"version": ' + b"9" * 5000 + b"}", "text that does not parse: lists in"),
        (b'{"version": 1, "version": 2, "edits": []}', 'got "version" twice in one object'),
        (
            b'{"version": 2, "edits": [{"type": "scale", "factor": NaN}]}',
            'edit 1 (scale): key "factor": expected a finite number above 0',
        ),
    ],
)
def test_bad_files(tmp_path: Path, content: bytes, expected: str):
    path = tmp_path / "twist.json"
    path.write_bytes(content)
    with pytest.raises(EditError) as caught:
        load_edit(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert expected in str(caught.value)


def test_missing_files_and_folders(tmp_path: Path):
    with pytest.raises(EditError, match=r"none\.json: edit file not found; expected a JSON file"):
        load_edit(tmp_path / "none.json")
    with pytest.raises(EditError, match=r": cannot be read"):
        load_edit(tmp_path)
    script = one(type="scale", factor=2)
    with pytest.raises(EditError, match="expected an existing folder to write to"):
        script.save(tmp_path / "none" / "edit.json")
    with pytest.raises(EditError, match="cannot write the edit file"):
        script.save(tmp_path)


def bind_message(points: torch.Tensor, edit: dict, **options) -> str:
    content = {"version": 2, "edits": [{"type": "scale", "factor": 2}, edit]}
    with pytest.raises(EditError) as caught:
        parse_edit(content, source="edit.json").bind(points, **options)
    return str(caught.value)


def test_a_fold_is_refused_and_counted():
    points = cloud()
    edit = {"type": "stretch", "axis": "z", "factor": 5}
    text = bind_message(points, edit)
    assert text.startswith("edit.json: edit 2 (stretch): singular deformation: ")
    k = 5 / float(2 * (points[:, 2].max() - points[:, 2].min()))
    # The factor on both cross directions is negative here, so det J alone would see nothing.
    middle = int((1 - k + k * (2 * points[:, 2]) ** 2 <= 0).sum())
    assert 0 < middle < 200
    assert f"at {middle} of 200 points" in text
    assert 'use the profile "axial" or "volume"' in text


def test_a_bend_that_folds_says_at_how_many_points():
    points = cloud()
    text = bind_message(points, {"type": "bend", "axis": "z", "angle_deg": 300})
    rate = math.radians(300) / float(2 * (points[:, 0].max() - points[:, 0].min()))
    folded = int((1 - rate * 2 * points[:, 1] <= 0).sum())
    assert 0 < folded < 200
    assert f"nearly 0 at {folded} of 200 points" in text


def test_folds_can_be_allowed_but_not_everywhere():
    points = cloud()
    content = {"type": "bend", "axis": "z", "angle_deg": 300}
    assert isinstance(one(**content).bind(points, allow_folds=True), Bend)
    flat = {"type": "stretch", "axis": "z", "factor": -1, "extent": [0, 1], "limits": [0, 1]}
    text = bind_message(torch.rand(50, 3) * 0.4, flat, allow_folds=True)
    assert "at 50 of 50 points" in text


def test_the_check_alone():
    points = cloud()
    check_invertible(one(type="twist", axis="x", angle_deg=60).bind(points), points)
    mirror = Affine(torch.diag(torch.tensor([-1.0, 1.0, 1.0])), torch.zeros(3))
    with pytest.raises(EditError, match="at 200 of 200 points"):
        check_invertible(mirror, points)
    wild = Taper(rotation=axis_frame("z"), origin=torch.zeros(3), extent=(0.0, 1.0), value=1e30)
    far = torch.tensor([[1e30, 0.0, 1.0], [0.0, 0.0, 0.0]])
    with pytest.raises(EditError, match="sends 1 of 2 points to NaN or infinity"):
        check_invertible(wild, far)


def test_points_without_extent():
    twist = {"type": "twist", "axis": "z", "angle_deg": 20}
    flat = cloud() * torch.tensor([1.0, 1.0, 0.0])
    assert "(twist): expected points that extend along the driving" in bind_message(flat, twist)
    assert "expected at least one point to take the extent from" in bind_message(
        torch.zeros(0, 3), twist
    )
    assert "edit.json: expected points (N, 3), got (4, 2)" in bind_message(torch.zeros(4, 2), twist)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('{"version": 2,\n "edits": [\n  1,\n ]\n}', r"line 3, column 4, .* comma .* \(1,\)"),
        ('{"version": 2,\n "edits": [],\n}', r'line 2, .* delete the comma \("edits": \[\],\)'),
        ('{"version": 2\n "edits": []}', r'line 2, column 2, from .* \("edits": \[\]}\)'),
        (" \n", "got an empty file"),
    ],
)
def test_broken_json_is_shown_with_its_line(tmp_path: Path, text: str, expected: str):
    file = tmp_path / "edit.json"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(EditError, match=expected):
        load_edit(file)


SEAM: dict[str, object] = {"shape": "half_space", "origin": [0, 0, -0.2], "falloff": 0.01}
LOW, HIGH = SEAM | {"normal": [0, 0, -1]}, SEAM | {"normal": [0, 0, 1]}


@pytest.mark.parametrize(
    ("whole", "edit", "expected"),
    [
        ({"freeze": [LOW]}, {}, 'widen the falloff of what "freeze" holds, or'),
        ({}, {"freeze": [LOW]}, 'widen the falloff of what "freeze" holds, or'),
        ({}, {"region": HIGH}, "widen the falloff of the region, or"),
        ({"freeze": [LOW]}, {"region": HIGH}, 'of the region or of what "freeze" holds, or'),
    ],
)
def test_a_seam_that_folds_is_named(whole: dict, edit: dict, expected: str):
    points = torch.rand(4000, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1
    push = {"type": "rigid", "translation": [0, 0, -1]}
    made = parse_edit({"version": 2, **whole, "edits": [push | edit]})
    with pytest.raises(EditError, match=expected):
        made.bind(points)
