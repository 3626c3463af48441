"""Commands on the stack of a session: laws that hold for any sequence of them."""

import random
from pathlib import Path

import pytest
import torch

from pcore.deform.jacobian import analytic_maps
from pcore.deform.pose import pose
from pcore.editing.animation import load_animation
from pcore.editing.script import load_edit
from pcore.editing.session import EditSession
from pcore.editing.state import EditState
from pcore.errors import EditError
from pcore.geometry.point_cloud import PointCloud

TWIST = {"type": "twist", "axis": "z", "angle_deg": 20}
SHIFT = {"type": "rigid", "translation": [0, 0, 0.1]}
GROW = {"type": "scale", "factor": 1.2}
TAPER = {"type": "taper", "axis": "x", "factor": 0.2}
TOP = {"shape": "half_space", "origin": [0, 0, 0.1], "normal": [0, 0, 1], "falloff": 0.5}
BALL = {"shape": "geodesic", "center": [0.3, 0, 0], "radius": 0.2, "falloff": 0.3}
HANDLE = {
    "type": "anchors",
    "count": 12,
    "handles": [{"near": [0.4, 0, 0], "to": [0.4, 0, 0.1]}],
}
FOLD = {"type": "bend", "axis": "z", "angle_deg": 300}
EDITS = [
    TWIST,
    SHIFT,
    GROW,
    TAPER,
    {**TWIST, "axis": "x", "region": TOP},
    {**SHIFT, "region": BALL},
]


def cloud() -> torch.Tensor:
    return torch.rand(200, 3, generator=torch.Generator().manual_seed(2)) - 0.5


def session(*edits: dict) -> EditSession:
    made = EditSession(cloud())
    for edit in edits:
        made.do(edit)
    return made


def afresh(state: EditState) -> EditState:
    return EditSession(cloud(), state.script).state


def at_random(made: EditSession, draw: random.Random) -> None:
    """One command, which may be refused."""
    count = len(made.stack.edits)
    some, other = draw.randrange(max(count, 1)), draw.randrange(max(count, 1))
    edit = draw.choice(EDITS)
    commands = [
        lambda: made.do(edit, merge=draw.choice([None, "drag"])),
        lambda: made.do(edit),
        lambda: made.replace(some, edit, merge=draw.choice([None, "slide"])),
        lambda: made.set(some, "enabled", draw.random() < 0.5),
        lambda: made.set(some, "factor", draw.uniform(0.7, 1.4)),
        lambda: made.remove(some),
        lambda: made.move(some, other),
        lambda: made.mute(some, draw.random() < 0.5),
        lambda: made.rename(some, draw.choice(["hand", None])),
        lambda: made.duplicate(some),
        lambda: made.key(some, "angle_deg", draw.choice([0.0, 1.0, 2.0]), draw.uniform(-20, 20)),
        lambda: made.unkey(some, "angle_deg", 1.0),
        lambda: made.freeze(*([TOP] if draw.random() < 0.3 else [])),
        lambda: made.at(draw.uniform(0, 2)),
        made.undo,
        made.redo,
    ]
    before = made.state, made.history, made.time
    try:
        draw.choice(commands)()
    except EditError:
        assert (made.state, made.history, made.time) == before


@pytest.mark.parametrize("seed", range(4))
def test_any_sequence_of_commands_can_be_undone_and_saved_and_gives_the_same_points(
    seed: int, tmp_path: Path
):
    draw = random.Random(seed)
    made = session()
    for number in range(50):
        at_random(made, draw)
        state = made.state
        if number % 5 == 0:
            made.save(tmp_path / "edit.json")
            again = load_animation(tmp_path / "edit.json").at(made.time)
            assert again == state.script
            fresh = EditSession(cloud(), again).state
            assert torch.equal(fresh.points, state.points)
            assert torch.equal(fresh.bound.linear, state.bound.linear)
            assert torch.equal(fresh.bound.folded, state.bound.folded)
    last = made.stack
    steps = 0
    while made.can_undo:
        made.undo()
        steps += 1
    assert made.stack.edits == ()
    assert torch.equal(made.state.points, cloud())
    while made.can_redo:
        made.redo()
    assert made.stack == last or steps == 0


def test_what_is_merged_is_one_step():
    made = session(TWIST)
    before = made.state
    for angle in (1, 2, 3):
        made.do({**TWIST, "angle_deg": angle}, merge="drag")
    assert [edit.angle_deg for edit in made.state.script.edits] == [20, 3]
    for angle in (4, 5):
        made.set(0, "angle_deg", angle, merge="slider")
    assert made.state.script.edits[0].angle_deg == 5
    made.undo()
    assert [edit.angle_deg for edit in made.state.script.edits] == [20, 3]
    assert made.undo() is before
    # After an undo nothing is merged with what was undone.
    made.do({**TWIST, "angle_deg": 7}, merge="drag")
    assert len(made.stack.edits) == 2


def test_each_command_changes_the_stack_as_it_says():
    made = session(TWIST, SHIFT, GROW)
    kinds = lambda: [edit.type for edit in made.state.script.edits]  # noqa: E731
    made.move(0, 2)
    assert kinds() == ["rigid", "scale", "twist"]
    made.duplicate(1)
    assert kinds() == ["rigid", "scale", "scale", "twist"]
    made.remove(0)
    made.remove(0)
    assert kinds() == ["scale", "twist"]
    named = made.rename(1, "waist")
    assert named.script.edits[1].name == "waist"
    assert torch.equal(named.points, made.undo().points)
    only = made.mute(1).points
    torch.testing.assert_close(only, 1.2 * cloud())
    assert not torch.equal(made.mute(1, False).points, only)
    made.replace(0, SHIFT)
    assert kinds() == ["rigid", "twist"]
    assert made.history.present.label == "change rigid"


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (lambda made: made.remove(2), "the number of an edit, 0 to 1, got 2"),
        (lambda made: made.move(0, -1), "the number of an edit, 0 to 1, got -1"),
        (lambda made: EditSession(cloud()).mute(0), "expected an edit, there is none, got 0"),
        (lambda made: made.rename(0, ""), 'key "name": expected a text, not long, got ""'),
        (lambda made: made.set(0, "angle", 3), 'unknown key "angle" for a twist'),
        (
            lambda made: made.set(0, "axis/0/1", 3),
            'expected a place within the edit, got no "axis"',
        ),
        (lambda made: made.key(0, "angle_deg", 0.0, "far"), "keyframe 1: expected"),
        (lambda made: made.unkey(0, "angle_deg", 0.0), "the time of a key (none), got 0"),
        (lambda made: made.replace(0, FOLD), "edit 1 (bend): singular deformation"),
    ],
)
def test_what_cannot_be_done_says_why_and_changes_nothing(command, said: str):
    made = session(TWIST, SHIFT)
    now = made.state
    with pytest.raises(EditError) as caught:
        command(made)
    assert said in str(caught.value)
    assert made.state is now


@pytest.mark.parametrize("freeze", [(), (TOP,)])
def test_frames_of_a_stack_are_those_of_a_fresh_computation_bit_for_bit(freeze):
    made = session(*EDITS, HANDLE)
    made.freeze(*freeze)
    state = made.preview({**HANDLE, "amount": 0.5}, at=len(EDITS))
    whole = state.script.bind(cloud())
    rest = cloud().double()
    assert torch.equal(state.bound.linear, whole.jacobian(rest))
    assert torch.equal(state.points, whole(rest).float())
    assert torch.equal(state.bound.folded, whole.folded(rest))
    kept, fresh = (analytic_maps(one, rest) for one in (state.bound.known, whole))
    assert torch.equal(kept.to_rest, fresh.to_rest)
    assert torch.equal(state.bound.known(rest + 0.01), whole(rest + 0.01))


def test_only_the_edits_from_the_changed_one_on_are_bound_again(monkeypatch: pytest.MonkeyPatch):
    from pcore.editing.edits import TwistEdit

    bound: list[float] = []
    bind = TwistEdit.bind

    def counting(self: TwistEdit, points: torch.Tensor):
        bound.append(self.angle_deg)
        return bind(self, points)

    monkeypatch.setattr(TwistEdit, "bind", counting)
    made = session(*[{**TWIST, "angle_deg": angle} for angle in range(5)])
    bound.clear()
    made.preview({**TWIST, "angle_deg": 9}, at=3)
    assert bound == [9, 4]
    bound.clear()
    made.rename(0, "first")
    made.undo()
    assert bound == []


def test_a_fold_is_drawn_and_only_refused_when_it_is_done():
    made = session(TWIST)
    shown = made.preview(FOLD)
    assert len(shown.folds) > 0
    assert shown.rays == "plain"
    assert made.state.rays == "aware"
    papr_cloud = PointCloud(
        positions=cloud(), features=torch.zeros(200, 2), influence=torch.zeros(200)
    )
    drawn = pose(papr_cloud, shown.bound.known, aware=False)
    assert torch.equal(drawn.positions, shown.points)
    with pytest.raises(EditError, match="singular deformation"):
        made.preview(FOLD, folds="refuse")
    with pytest.raises(EditError, match="singular deformation"):
        made.do(FOLD)


def test_values_are_keyed_and_the_film_is_that_of_the_file(tmp_path: Path):
    made = session(TWIST, SHIFT)
    made.key(0, "angle_deg", 0.0, 0.0)
    made.key(0, "angle_deg", 2.0, 40.0, easing="smooth")
    made.key(1, "translation", 1.0, [0, 0, 0.3])
    assert made.tracks(0) == {
        "angle_deg": {"keyframes": [[0.0, 0.0], [2.0, 40.0]], "easing": "smooth"}
    }
    made.save(tmp_path / "edit.json")
    film = load_animation(tmp_path / "edit.json")
    assert film.key_times == (0, 1, 2)
    for time in (0.0, 0.7, 2.0):
        assert torch.equal(made.at(time).points, EditSession(cloud(), film.at(time)).state.points)
    with pytest.raises(EditError, match="expected a value that stands still"):
        made.set(0, "angle_deg", 3)
    other = EditSession(cloud())
    other.load(tmp_path / "edit.json")
    assert torch.equal(other.at(0.7).points, made.at(0.7).points)
    for time in (0.0, 2.0):
        made.unkey(0, "angle_deg", time)
    assert made.tracks(0) == {}
    assert made.state.script.edits[0].angle_deg == 40.0


def test_states_far_back_are_let_go_and_come_again_the_same():
    made = session()
    points = []
    for number in range(40):
        points.append(made.do({**SHIFT, "translation": [0, 0, 0.01 * number]}).points)
    assert len(made._states) < 30
    for expected in reversed(points):
        assert torch.equal(made.state.points, expected)
        made.undo()


def test_a_saved_name_and_a_muted_edit_are_read_back(tmp_path: Path):
    made = session(TWIST, SHIFT)
    made.rename(0, "waist")
    made.mute(1)
    made.save(tmp_path / "edit.json")
    script = load_edit(tmp_path / "edit.json")
    assert script == made.state.script
    assert [edit.enabled for edit in script.edits] == [True, False]
    assert torch.equal(afresh(made.state).points, made.state.points)


def test_hours_of_commands_do_not_add_up(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("pcore.editing.history.LONGEST", 20)
    made = session()
    for number in range(50):
        made.do({**SHIFT, "translation": [0, 0, 0.001 * number]}, merge=None)
        made.remove(0)
    assert len(made.history.moments) == 20
    last = made.state
    while made.can_undo:
        made.undo()
    assert made.history.now == 0
    while made.can_redo:
        made.redo()
    assert torch.equal(made.state.points, last.points)
