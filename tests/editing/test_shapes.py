"""Edits that come from files: cage, mesh, displacement."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from pcore.deform.cage import Cage
from pcore.editing import cage_edit as cages
from pcore.editing.animation import Animation
from pcore.editing.script import EditScript, load_edit, parse_edit
from pcore.editing.session import EditSession
from pcore.errors import EditError

TWIST = {"type": "twist", "axis": "z", "angle_deg": 20}
TURN = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


def cloud() -> torch.Tensor:
    points = torch.randn(300, 3, generator=torch.Generator().manual_seed(2))
    return torch.nn.functional.normalize(points, dim=-1) * 0.9


def script(**edit) -> EditScript:
    return parse_edit({"version": 2, "edits": [edit]}, source="edit.json")


def bind_message(**edit) -> str:
    made = script(**edit)
    with pytest.raises(EditError) as caught:
        made.bind(cloud())
    text = str(caught.value)
    assert text.startswith(f"edit.json: edit 1 ({edit['type']}): ")
    return text


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same ball before and after in all formats, and points with where they go."""
    monkeypatch.chdir(tmp_path)
    mesh = trimesh.creation.icosphere(subdivisions=2)
    turned = mesh.copy()
    turned.vertices = mesh.vertices @ TURN.numpy().T + [0, 0, 0.5]
    for ending in ("ply", "obj", "glb"):
        mesh.export(f"before.{ending}")
        turned.export(f"after.{ending}")
    np.save("before.npy", cloud().numpy())
    np.save("after.npy", (cloud() @ TURN.T + 0.5).numpy())
    return tmp_path


@pytest.mark.parametrize("ending", ["ply", "obj", "glb"])
@pytest.mark.parametrize("kind", ["cage", "mesh"])
def test_a_mesh_in_two_shapes(kind: str, ending: str):
    points = cloud()
    made = script(type=kind, before=f"before.{ending}", after=f"after.{ending}")
    moved = made.bind(points)(points)
    expected = points @ TURN.T + torch.tensor([0, 0, 0.5])
    torch.testing.assert_close(moved, expected, rtol=0, atol=1e-5)
    jacobian = made.bind(points).jacobian(points)
    torch.testing.assert_close(jacobian, TURN.expand(300, 3, 3), rtol=0, atol=1e-4)


@pytest.mark.parametrize("kind", ["cage", "mesh"])
def test_files_with_y_up(kind: str):
    for name in ("before", "after"):
        mesh = trimesh.load_mesh(f"{name}.ply", process=False)
        x, y, z = mesh.vertices.T
        mesh.vertices = np.stack([x, z, -y], axis=1)
        mesh.export(f"{name}_y.obj")
    points = cloud()
    made = script(type=kind, before="before_y.obj", after="after_y.obj", up="y")
    expected = points @ TURN.T + torch.tensor([0, 0, 0.5])
    torch.testing.assert_close(made.bind(points)(points), expected, rtol=0, atol=1e-5)


def test_a_cage_in_a_region_and_with_frozen_points():
    points = cloud()
    upper = {"shape": "half_space", "normal": "z", "origin": [0, 0, 0.5], "falloff": 2}
    half = script(type="cage", before="before.ply", after="after.ply", region=upper)
    moved = half.bind(points, allow_folds=True)(points)
    high = points[:, 2] > 0.5
    expected = points @ TURN.T + torch.tensor([0, 0, 0.5])
    torch.testing.assert_close(moved[high], expected[high], rtol=0, atol=1e-5)
    assert float((moved - expected)[~high].norm(dim=-1).max()) > 0.1


def test_displacement_by_id_is_exact():
    points = cloud()
    made = script(type="displacement", before="before.npy", after="after.npy")
    bound = made.bind(points)
    assert torch.equal(bound(points), points @ TURN.T + 0.5)
    # Points on a sheet: the turn is found, the scale across is not asked for.
    jacobian = bound.jacobian(points.double())
    torch.testing.assert_close(jacobian, TURN.double().expand(300, 3, 3), rtol=0, atol=0.02)


def test_displacement_by_position_serves_another_cloud_of_the_object():
    other = torch.nn.functional.normalize(
        torch.randn(500, 3, generator=torch.Generator().manual_seed(7)), dim=-1
    )
    content = {"type": "displacement", "before": "before.npy", "after": "after.npy"}
    made = script(**content, match="position", tolerance=0.3)
    moved = made.bind(0.9 * other)(0.9 * other)
    expected = 0.9 * other @ TURN.T + 0.5
    assert float((moved - expected).norm(dim=-1).max()) < 0.02
    order = torch.randperm(300, generator=torch.Generator().manual_seed(1))
    moved = script(**content, match="position").bind(cloud()[order])(cloud()[order])
    assert torch.equal(moved, (cloud() @ TURN.T + 0.5)[order])


def test_files_are_found_from_the_edit_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    content = {"type": "displacement", "before": "before.npy", "after": "after.npy"}
    script(**content).save(tmp_path / "edit.json")
    monkeypatch.chdir("/")
    again = load_edit(tmp_path / "edit.json")
    assert torch.equal(again.bind(cloud())(cloud()), cloud() @ TURN.T + 0.5)


@pytest.mark.parametrize("kind", ["cage", "mesh"])
@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ("before.ply", "none.ply", "none.ply: no such file; expected a mesh"),
        (
            "before.ply",
            "after.stl",
            "after.stl: expected a mesh that ends in .ply, .obj, .glb or .gltf",
        ),
        ("before.ply", "few.ply", "few.ply: expected the 162 vertices of"),
        ("before.ply", "order.ply", "order.ply: expected the same faces as in"),
        ("before.ply", "nan.obj", "nan.obj: expected finite coordinates, got NaN"),
        ("before.ply", "bare.ply", "bare.ply: expected a mesh"),
        ("before.ply", "text.obj", "text.obj: expected a mesh with faces"),
    ],
)
def test_pairs_that_do_not_fit(kind: str, before: str, after: str, expected: str):
    mesh = trimesh.creation.icosphere(subdivisions=1)
    mesh.export("few.ply")
    mesh = trimesh.load_mesh("before.ply", process=False)
    trimesh.Trimesh(mesh.vertices, np.roll(mesh.faces, 1, axis=0), process=False).export(
        "order.ply"
    )
    text = re.sub(r"v \S+", "v nan", Path("before.obj").read_text(), count=1)
    Path("nan.obj").write_text(text)
    trimesh.PointCloud(mesh.vertices).export("bare.ply")
    Path("text.obj").write_text("hello")
    assert expected in bind_message(type=kind, before=before, after=after)


def test_an_open_cage_is_refused():
    mesh = trimesh.load_mesh("before.ply", process=False)
    trimesh.Trimesh(mesh.vertices, mesh.faces[:-1], process=False).export("open.ply")
    text = bind_message(type="cage", before="open.ply", after="open.ply")
    assert "expected a closed mesh" in text
    assert "got 3 open edges; close its holes" in text


def test_a_mesh_elsewhere_is_refused():
    mesh = trimesh.load_mesh("before.ply", process=False)
    mesh.vertices *= 100
    mesh.export("large.ply")
    text = bind_message(type="mesh", before="large.ply", after="large.ply")
    assert "large.ply: expected a mesh that lies at the points, got one that half" in text
    assert 'check its units and the axis that is "up"' in text


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"after": "short.npy"}, "short.npy: expected a new place for each of the 300 points of"),
        ({"before": "short.npy", "after": "short.npy"}, "expected the 300 points that arrive at"),
        ({"before": "order.npy"}, "got the same points in another order: "),
        ({"before": "far.npy"}, "got other points: 1 are more than 0.00"),
        ({"before": "far.npy"}, 'the first is number 7; use "match": "position"'),
        ({"before": "far.npy", "match": "position"}, "got none for 1 of 300, the farthest is"),
        ({"after": "nan.npy"}, "nan.npy: expected finite coordinates, got NaN or infinity in 1 of"),
        ({"after": "none.npy"}, "none.npy: no such file"),
    ],
)
def test_displacements_that_do_not_fit(change: dict, expected: str):
    np.save("short.npy", cloud()[:10].numpy())
    np.save("order.npy", cloud().flip(0).numpy())
    far, nan = cloud(), cloud()
    far[7] *= 3
    nan[3, 1] = float("nan")
    np.save("far.npy", far.numpy())
    np.save("nan.npy", nan.numpy())
    content = {"type": "displacement", "before": "before.npy", "after": "after.npy", **change}
    assert expected in bind_message(**content)


@pytest.mark.parametrize(
    ("edit", "expected"),
    [
        ({"type": "cage", "before": "a.ply"}, 'key "after": expected the path of a mesh'),
        ({"type": "mesh", "before": 3, "after": "b.ply"}, 'key "before": expected the path of a'),
        ({"type": "cage", "before": "a", "after": "b", "up": "x"}, 'key "up": expected "y" or "z"'),
        (
            {"type": "displacement", "before": "a", "after": "b", "match": "name"},
            'key "match": expected "id" or "position", got "name"',
        ),
        (
            {"type": "displacement", "before": "a", "after": "b", "tolerance": 0},
            'key "tolerance": expected a length above 0, world units, got 0',
        ),
    ],
)
def test_bad_keys(edit: dict, expected: str):
    with pytest.raises(EditError) as caught:
        script(**edit)
    assert expected in str(caught.value)


def test_a_bad_file_leaves_a_session_as_it_was():
    session = EditSession(cloud())
    now = session.state
    with pytest.raises(EditError, match=r"edit 1 .cage.: .*none\.ply: no such file"):
        session.do({"type": "cage", "before": "before.ply", "after": "none.ply"})
    assert session.state is now


def test_a_cage_that_holds_no_point_is_refused():
    mesh = trimesh.load_mesh("before.ply", process=False)
    mesh.vertices += [0, 0, 5]
    mesh.export("beside.ply")
    text = bind_message(type="cage", before="beside.ply", after="beside.ply")
    assert (
        "beside.ply: expected a cage around the object, got one that holds none of the 300" in text
    )
    assert "it goes from (-1, -1, 4) to (1, 1, 6), they from (-0.89" in text
    assert 'check its units and the axis that is "up"' in text
    # A flat sheet of two sides is closed and holds nothing.
    flat = trimesh.Trimesh([[-9, -9, 0], [9, -9, 0], [0, 9, 0]], [[0, 1, 2], [0, 2, 1]])
    flat.export("flat.ply")
    text = bind_message(type="cage", before="flat.ply", after="flat.ply")
    assert "holds none of the 300 points" in text


def test_points_outside_a_cage_are_counted():
    mesh = trimesh.load_mesh("before.ply", process=False)
    mesh.vertices[:, 2] += 1
    mesh.export("high.ply")
    points = cloud()
    made = script(type="cage", before="high.ply", after="high.ply")
    expected = int(((points - torch.tensor([0, 0, 1])).norm(dim=-1) > 1).sum())
    (note,) = made.bound(points).notes
    count = int(note.removeprefix("edit 1 (cage): ").split(" of 300 points lie outside")[0])
    assert abs(count - expected) < 12  # The cage is a ball with corners.
    assert count > 100
    held = {"shape": "half_space", "normal": "z", "origin": [0, 0, 0.6], "falloff": 0}
    assert (
        script(type="cage", before="high.ply", after="high.ply", region=held).bound(points).notes
        == ()
    )
    assert script(type="cage", before="before.ply", after="after.ply").bound(points).notes == ()
    low = {"shape": "half_space", "normal": [0, 0, -1], "origin": [0, 0, -0.1], "falloff": 0}
    made = script(type="cage", before="high.ply", after="high.ply", region=low)
    with pytest.raises(EditError, match="holds none of the"):
        made.bind(points)


def notes_of(**edit) -> str:
    return "\n".join(script(**edit).bound(cloud()).notes)


@pytest.mark.parametrize("kind", ["cage", "mesh"])
def test_shapes_in_different_units_are_noted(kind: str):
    mesh = trimesh.load_mesh("after.ply", process=False)
    for share, odd in ((4, False), (6, True), (1 / 4, False), (1 / 6, True)):
        trimesh.Trimesh(mesh.vertices * share, mesh.faces, process=False).export("other.ply")
        said = notes_of(type=kind, before="before.ply", after="other.ply")
        assert ("are both files in the same units?" in said) == odd
    assert '"before" is 3.46 large and "after" 0.577, world units' in said
    assert notes_of(type=kind, before="before.ply", after="after.ply") == ""


def test_displacements_in_other_units_are_noted():
    for share in (1, 100):
        np.save("far.npy", share * np.load("before.npy"))
        said = notes_of(type="displacement", before="before.npy", after="far.npy")
        assert ("are both files in the same units?" in said) == (share == 100)
        assert ("more than 2 times the object's size" in said) == (share == 100)


def test_a_cage_much_larger_than_the_object_is_noted():
    mesh = trimesh.load_mesh("before.ply", process=False)
    for share, odd in ((8, False), (12, True)):
        trimesh.Trimesh(mesh.vertices * share, mesh.faces, process=False).export("large.ply")
        said = notes_of(type="cage", before="large.ply", after="large.ply")
        assert ("it should stand close around it" in said) == odd


def figure(turned: bool) -> trimesh.Trimesh:
    """A slab of 1 x 0.2 x 2 with z up, or as a file with y up has it."""
    slab = trimesh.creation.box(extents=(1, 0.2, 2)).subdivide().subdivide()
    if turned:
        x, y, z = slab.vertices.T
        slab.vertices = np.stack([x, z, -y], axis=1)
    return slab


@pytest.mark.parametrize("turned", [False, True])
def test_a_mesh_with_the_wrong_axis_upwards_is_refused(turned: bool):
    figure(turned).export("slab.obj")
    points = torch.from_numpy(figure(turned=False).sample(500, seed=1)).float()
    right, wrong = ("y", "z") if turned else ("z", "y")
    edit = {"type": "mesh", "before": "slab.obj", "after": "slab.obj"}
    assert script(**edit, up=right).bound(points).notes == ()
    with pytest.raises(EditError, match=f'got "up": "{wrong}", with which .*give "up": "{right}"'):
        script(**edit, up=wrong).bind(points)


def test_a_coarse_mesh_is_taken_and_one_beside_the_object_noted():
    points = torch.from_numpy(figure(turned=False).sample(500, seed=1)).float()
    coarse = trimesh.creation.box(extents=(1.1, 0.3, 2.1))
    for shift, odd in ((0, False), (0.5, True)):
        coarse.vertices += [0, shift, 0]
        coarse.export("coarse.ply")
        made = script(type="mesh", before="coarse.ply", after="coarse.ply")
        said = "".join(made.bound(points).notes)
        assert ("is it the mesh of this object" in said) == odd


def test_a_mesh_of_a_part_serves_an_edit_in_that_part():
    points = torch.from_numpy(figure(turned=False).sample(500, seed=1)).float()
    part = figure(turned=False)
    part.vertices = part.vertices * [1, 1, 0.2] + [0, 0, 0.8]
    part.export("part.ply")
    edit = {"type": "mesh", "before": "part.ply", "after": "part.ply"}
    upper = {"shape": "half_space", "normal": "z", "origin": [0, 0, 0.6], "falloff": 0}
    assert script(**edit, region=upper).bound(points).notes == ()
    with pytest.raises(EditError, match="expected a mesh that lies at the points"):
        script(**edit).bind(points)


KINDS = [
    {"type": "cage", "before": "before.ply", "after": "after.ply"},
    {"type": "mesh", "before": "before.ply", "after": "after.ply"},
    {"type": "displacement", "before": "before.npy", "after": "after.npy"},
]


@pytest.mark.parametrize("edit", KINDS)
def test_a_share_of_an_edit_from_a_file(edit: dict):
    points = cloud().double()
    whole = script(**edit).bind(points)
    none, part = (script(**edit, amount=amount).bind(points) for amount in (0, 0.25))
    assert torch.equal(none(points), points)
    torch.testing.assert_close(none.jacobian(points), torch.eye(3).double().expand(300, 3, 3))
    torch.testing.assert_close(part(points), points + 0.25 * (whole(points) - points))
    expected = 0.75 * torch.eye(3).double() + 0.25 * whole.jacobian(points)
    torch.testing.assert_close(part.jacobian(points), expected)
    assert torch.equal(script(**edit, amount=1.0).bind(points)(points), whole(points))


def test_amounts_are_animated_and_checked():
    edit = {**KINDS[2], "amount": {"keyframes": [[0, 0], [2, 1]]}}
    made = Animation({"version": 2, "edits": [edit]})
    half = made.at(1).bind(cloud())(cloud())
    whole = made.at(2).bind(cloud())(cloud())
    torch.testing.assert_close(half, 0.5 * (cloud() + whole))
    with pytest.raises(EditError, match=r'key "amount": expected a finite number: 0 changes not'):
        script(**{**KINDS[2], "amount": "half"})


def test_a_cage_whose_new_vertices_stand_in_the_edit(tmp_path: Path):
    after = torch.from_numpy(trimesh.load_mesh("after.ply", process=False).vertices.copy())
    made = script(type="cage", before="before.ply", after=after.tolist())
    points = cloud()
    expected = script(**KINDS[0]).bind(points)(points)
    torch.testing.assert_close(made.bind(points)(points), expected)
    made.save(tmp_path / "edit.json")
    assert load_edit(tmp_path / "edit.json") == made
    text = bind_message(type="cage", before="before.ply", after=after[:9].tolist())
    assert 'key "after": expected the 162 vertices of' in text
    with pytest.raises(EditError, match=r'key "after": expected the path of a mesh .*, or a list'):
        script(type="cage", before="before.ply", after=[[0, 0]])


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """How often points were bound to a cage, its slopes found, and its map computed without."""
    calls = {"bind": 0, "slopes": 0, "carry": 0}
    for name in calls:
        whole = getattr(Cage, name)

        def counting(self, *args, _name=name, _whole=whole, **more):
            calls[_name] += 1
            return _whole(self, *args, **more)

        monkeypatch.setattr(Cage, name, counting)
    cages._bound.cache_clear()
    cages._deform.cache_clear()
    return calls


def test_a_second_drag_and_its_commit_bind_nothing_and_find_no_slopes(counted: dict[str, int]):
    session = EditSession(cloud())
    rest = torch.from_numpy(trimesh.load_mesh("before.ply", process=False).vertices.copy())
    for step in (0.1, 0.2, 0.3):
        after = (rest + torch.tensor([0, 0, step])).tolist()
        shown = session.preview({"type": "cage", "before": "before.ply", "after": after})
        torch.testing.assert_close(shown.points, cloud() + torch.tensor([0, 0, step]))
    assert counted == {"bind": 1, "slopes": 0, "carry": 0}
    done = session.do({"type": "cage", "before": "before.ply", "after": after})
    assert torch.equal(done.points, shown.points)
    assert counted == {"bind": 1, "slopes": 1, "carry": 0}
    further = (rest + torch.tensor([0, 0, 0.4])).tolist()
    session.replace(0, {"type": "cage", "before": "before.ply", "after": further})
    assert counted == {"bind": 1, "slopes": 1, "carry": 0}


def test_jacobians_of_a_cage_serve_all_amounts(counted: dict[str, int]):
    for amount in (0.25, 0.5, 1.0):
        script(**KINDS[0], amount=amount).bind(cloud())
    assert counted == {"bind": 1, "slopes": 1, "carry": 0}


def test_a_mesh_that_was_written_anew_is_read_anew():
    session = EditSession(cloud())
    first = session.preview(KINDS[0]).points
    mesh = trimesh.load_mesh("after.ply", process=False)
    mesh.vertices += [0, 0, 1]
    mesh.export("after.ply")
    again = session.preview(KINDS[0]).points
    torch.testing.assert_close(again, first + torch.tensor([0, 0, 1.0]))


@pytest.mark.parametrize("kind", ["cage", "mesh"])
@pytest.mark.parametrize("path", ["a\0.ply", ""])
def test_texts_that_are_no_paths(kind: str, path: str):
    for key, pair in (("before", (path, "after.ply")), ("after", ("before.ply", path))):
        with pytest.raises(EditError, match=f'key "{key}": expected the path of a mesh'):
            script(type=kind, before=pair[0], after=pair[1])


def wave_and_mesh() -> list[dict]:
    np.save("wave.npy", (cloud() + 0.2 * torch.sin(2 * cloud().roll(1, dims=1))).numpy())
    mesh = trimesh.load_mesh("before.ply", process=False)
    after = (mesh.vertices + 0.2 * np.sin(2 * np.roll(mesh.vertices, 1, axis=1))).tolist()
    return [
        {"type": "displacement", "before": "before.npy", "after": "wave.npy"},
        {"type": "mesh", "before": "before.ply", "after": after},
    ]


@pytest.mark.parametrize("number", [0, 1])
def test_quick_frames_go_with_the_very_points_of_the_command(number: int):
    edit = wave_and_mesh()[number]
    session = EditSession(cloud())
    quick = session.preview({**edit, "amount": 0.8}, frames="quick")
    exact = session.preview({**edit, "amount": 0.8})
    assert torch.equal(quick.points, exact.points)
    error = (quick.bound.linear - exact.bound.linear).norm(dim=(1, 2))
    assert float(error.max()) < 0.3
    assert float(error.median()) < 0.1
    # With a mesh its triangles say it; of a motion that is known with care nothing is quick.
    assert (float(error.max()) == 0) == (edit["type"] == "mesh")
    again = session.preview({**edit, "amount": 0.8}, frames="quick")
    assert torch.equal(again.bound.linear, exact.bound.linear)
    session.do(edit)
    assert torch.equal(
        session.preview(TWIST, frames="quick").bound.before.linear, session.state.bound.linear
    )


def test_a_film_is_looked_through_quickly_and_the_state_stays_exact():
    edit = wave_and_mesh()[0]
    tracks = {"amount": {"keyframes": [[0, 0.0], [2, 1.0]]}}
    session = EditSession(cloud())
    session.do({**edit, **tracks})
    seen = session.at(1.0, frames="quick")
    assert session.time == 1.0
    assert torch.equal(seen.points, session.state.points)
    fresh = EditSession(cloud(), session.state.script).state
    assert torch.equal(session.state.bound.linear, fresh.bound.linear)


def test_points_that_were_written_anew_are_read_anew():
    edit = wave_and_mesh()[0]
    first = script(**edit).bind(cloud())(cloud())
    np.save("wave.npy", cloud().numpy())
    assert not torch.equal(script(**edit).bind(cloud())(cloud()), first)


def test_quick_frames_of_a_cage_need_no_formula_and_once_it_is_known_are_exact(
    monkeypatch: pytest.MonkeyPatch,
):
    mesh = trimesh.load_mesh("before.ply", process=False)
    after = (1.2 * mesh.vertices + 0.1 * np.sin(mesh.vertices[:, ::-1])).tolist()
    edit = {"type": "cage", "before": "before.ply", "after": after}
    session = EditSession(0.8 * cloud())
    with monkeypatch.context() as without:
        without.setattr("pcore.deform.cage.slopes_at", None)
        without.setattr(Cage, "carry", None)
        quick = session.preview(edit, frames="quick")
        linear = quick.bound.linear
    exact = session.preview(edit)
    assert torch.equal(quick.points, exact.points)
    error = (linear - exact.bound.linear).norm(dim=(1, 2))
    assert 0 < float(error.median()) < 0.2
    warm = session.preview({**edit, "name": "again"}, frames="quick")
    assert torch.equal(warm.bound.linear, exact.bound.linear)
