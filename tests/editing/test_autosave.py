"""A session that is kept in a file goes on where it was."""

import json
from pathlib import Path

import pytest
import torch

from pcore.editing.autosave import read_session, write_session
from pcore.editing.session import EditSession
from pcore.errors import EditError

TWIST = {"type": "twist", "axis": "z", "angle_deg": 40}


def cloud() -> torch.Tensor:
    return torch.rand(100, 3, generator=torch.Generator().manual_seed(2)) - 0.5


def a_session() -> EditSession:
    made = EditSession(cloud())
    made.do(TWIST)
    made.key(0, "angle_deg", 0.0, 10.0)
    made.key(0, "angle_deg", 1.0, 30.0)
    made.do({"type": "scale", "factor": 1.1})
    made.rename(1, "grow")
    made.undo()
    made.at(0.25)
    return made


def test_a_kept_session_goes_on_with_its_history_and_view(tmp_path: Path):
    made, path = a_session(), tmp_path / "autosave.json"
    write_session(path, made, {"eye": [1, 2, 3]})
    assert path.stat().st_size < 4000
    found = read_session(path, cloud())
    assert found.view == {"eye": [1, 2, 3]}
    other = found.session
    assert torch.equal(other.state.points, made.state.points)
    assert other.state.script == made.state.script
    assert [one.label for one in other.history.moments] == [
        one.label for one in made.history.moments
    ]
    other.redo()
    assert other.state.script.edits[1].name == "grow"
    while other.can_undo:
        other.undo()
    assert torch.equal(other.state.points, cloud())
    other.do(TWIST)
    assert other.can_undo


def test_a_long_history_is_kept_in_part(tmp_path: Path):
    made, path = EditSession(cloud()), tmp_path / "autosave.json"
    for number in range(130):
        made.do({"type": "scale", "factor": 1 + 0.001 * number}, merge=None)
        made.undo()
        made.do({"type": "scale", "factor": 1 + 0.001 * number})
        made.remove(0)
    write_session(path, made)
    other = read_session(path, cloud()).session
    assert len(other.history.moments) == 100
    assert other.stack == made.stack


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"version": 7}, "got something else or a damaged one"),
        ({"now": 99}, "got something else or a damaged one"),
        ({"edits": [{"version": 2, "edits": [{"type": "shear"}]}]}, "expected one of"),
        ({"points": "abc"}, "got one of other points; was the run trained again"),
    ],
)
def test_a_damaged_file_says_so(tmp_path: Path, change: dict, said: str):
    path = tmp_path / "autosave.json"
    write_session(path, a_session())
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(EditError, match=said):
        read_session(path, cloud())


def test_a_folder_that_is_gone_is_an_error_and_nothing_else(tmp_path: Path):
    with pytest.raises(EditError, match="cannot keep the session"):
        write_session(tmp_path / "gone" / "autosave.json", a_session())
