"""Deformed states in the layouts of published sets."""

from pathlib import Path

import pytest

import published_sets
from pcore.asset.training import train
from pcore.capture.load import find_states, load_scene, load_state
from pcore.cli.fit import photos_in
from pcore.errors import SceneError
from scene_files import change, change_frame, write_split


def test_of_a_sequence_in_time_the_first_stamp_is_learned(tmp_path: Path) -> None:
    scene = load_scene(published_sets.time_sequence(tmp_path / "jumping"))
    assert [len(scene.split(name)) for name in ("train", "test")] == [6, 2]
    assert {view.image.path.parent.parent.name for view in scene.split("train")} == {"of_0"}
    assert scene.states == find_states(tmp_path / "jumping") == ("t0.25", "t1")
    assert any("the views of time 0 are learned, 2 later states" in one for one in scene.notes)
    later = load_state(tmp_path / "jumping", "t0.25")
    assert [len(later.split(name)) for name in ("train", "test")] == [6, 2]
    assert {view.image.path.parent.parent.name for view in later.split("test")} == {"of_1"}
    assert len(photos_in(tmp_path / "jumping" / "t1", 1)) == 6  # What `pcore fit --photos` takes.


def test_one_time_stamp_is_no_sequence(tmp_path: Path) -> None:
    write_split(tmp_path, "train")  # Its frames say "time": 0.5.
    assert load_scene(tmp_path).states == ()


def test_one_camera_for_each_time_is_a_sequence_from_which_nothing_is_learned(
    tmp_path: Path,
) -> None:
    path = write_split(tmp_path, "train", count=3)
    for index in range(3):
        change_frame(path, index, time=index / 2)
    scene = load_scene(tmp_path)
    assert scene.states == ("t0", "t0.5", "t1")
    assert any("no object can be learned: its 3 states pose and score" in n for n in scene.notes)
    photos = [photos_in(tmp_path / state, 1) for state in scene.states]
    assert [[view.name for view in views] for views in photos] == [["r_0"], ["r_1"], ["r_2"]]
    said = r"give views from at least two directions \(a sequence in time with one photo"
    with pytest.raises(SceneError, match=said):
        train(scene)
    change_frame(path, 1, time=None)
    with pytest.raises(SceneError, match=r"expected 'time' in every frame .* got it in 2 of 3"):
        load_scene(tmp_path)


def test_stamps_that_a_computer_wrote_apart_are_one(tmp_path: Path) -> None:
    path = write_split(tmp_path, "train", count=4)
    for index, time in enumerate((0.1 + 0.2, 0.3, 0.7, 0.7000000001)):
        change_frame(path, index, time=time)
    assert len(load_scene(tmp_path).split("train")) == 2
    assert find_states(tmp_path) == ("t0.7",)


def test_a_time_that_no_number_holds_is_none(tmp_path: Path) -> None:
    path = write_split(tmp_path, "train", count=3)
    change_frame(path, 0, time=10**400)
    change_frame(path, 1, time="later")
    assert load_scene(tmp_path).states == ()


def test_a_deformed_scene_of_neural_editor_is_a_state(tmp_path: Path) -> None:
    scene = published_sets.neural_editor(tmp_path)
    assert load_scene(scene).states == ("box_data",)
    state = load_state(scene, "box_data")
    assert [len(state.split(name)) for name in ("train", "test")] == [6, 2]
    change(scene / "box_data" / "views_test" / "transforms.json", frames=None)
    with pytest.raises(SceneError, match=r"views_test/transforms\.json"):
        load_state(scene, "box_data")
