"""Folders of pictures as methods, and how they can be wrong."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import tiny_scene
from pcore.errors import InputError
from pcore.evaluation.picture_method import open_pictures
from pcore.evaluation.runner import evaluate
from pcore.evaluation.states import SceneStates, open_states


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_scene.write_scene(tmp_path_factory.mktemp("scenes") / "box")


@pytest.fixture
def states(scene: Path) -> SceneStates:
    return open_states(scene)


@pytest.fixture
def folder(scene: Path, tmp_path: Path) -> Path:
    """True pictures, as another code would write them."""
    for state, place in (("canonical", scene), ("grown", scene / "grown"), ("scale_2", scene)):
        shutil.copytree(place / "test", tmp_path / "theirs" / state)
    return tmp_path / "theirs"


def write_depth(path: Path, depth: np.ndarray) -> None:
    """As an array, or among others, as `pcore render --raw` writes it."""
    if path.suffix == ".npy":
        np.save(path, depth)
    else:
        np.savez(path, rgb=np.zeros(3), depth=depth)


def flatten(folder: Path) -> None:
    """Pictures over white, without alpha, as `pcore render` writes them."""
    for path in folder.glob("*/*.png"):
        rgba = Image.open(path).convert("RGBA")
        white = Image.new("RGBA", rgba.size, "white")
        Image.alpha_composite(white, rgba).convert("RGB").save(path)


def test_true_pictures_are_perfect(folder: Path, states: SceneStates) -> None:
    method = open_pictures("theirs", folder)
    assert method.tells == "opacity"
    rows = evaluate([method], states.select(["grown", "scale:2"]))
    assert len(rows) == 3 * 2 * 2
    for row in rows:
        assert row.scores["psnr"] is not None
        assert row.scores["psnr"] > 60
        assert row.scores["see_through_rate"] == 0
        assert row.scores["hole_rate"] is None  # Nothing says how far away the surface is.
        assert row.scores["strain_99"] is None


def test_pictures_without_alpha_tell_colours_alone(folder: Path, states: SceneStates) -> None:
    flatten(folder)
    method = open_pictures("theirs", folder)
    assert method.tells == "colour"
    (row, *_) = evaluate([method], states.select(["grown"]))
    assert row.scores["psnr"] is not None
    assert row.scores["psnr"] > 40
    assert row.scores["see_through_rate"] is None
    assert row.scores["spill"] is None


@pytest.mark.parametrize("ending", ["npy", "npz"])
def test_depth_beside_pictures_is_scored(folder: Path, states: SceneStates, ending: str) -> None:
    canonical, grown = states.select(["grown"])
    for state in (canonical, grown):
        for shot in state.shots:
            assert shot.depth is not None
            place = folder / state.name / f"{shot.view.name}.{ending}"
            depth = np.nan_to_num(shot.depth().numpy(), posinf=np.nan)
            write_depth(place, depth)
    shutil.rmtree(folder / "scale_2")
    method = open_pictures("theirs", folder)
    assert method.tells == "depth"
    (row, *_) = evaluate([method], [canonical, grown])
    assert row.scores["hole_rate"] == 0
    assert row.scores["depth_error"] is not None
    assert row.scores["depth_error"] < 1e-5
    place = folder / "grown" / f"r_0.{ending}"
    write_depth(place, np.zeros((3, 3)))
    with pytest.raises(InputError, match=rf"r_0.{ending}: expected camera z \(24, 24\) in floats"):
        evaluate([method], [grown])
    place.write_bytes(b"no array")
    with pytest.raises(InputError, match=rf"r_0.{ending}: expected an array of camera z, got"):
        evaluate([method], [grown])


def test_raw_files_beside_pictures_tell_opacity_and_depth(
    folder: Path, states: SceneStates
) -> None:
    """`pcore render --raw` writes colours over white, and all else in numbers."""
    grown = states.select(["grown"])[1]
    with_alpha = evaluate([open_pictures("theirs", folder)], [grown])
    flatten(folder)
    for shot in grown.shots:
        assert shot.depth is not None
        depth = np.nan_to_num(shot.depth().numpy(), posinf=np.nan)
        alpha = shot.view.rgba()[..., 3].numpy()
        np.savez(folder / "grown" / f"{shot.view.name}.npz", depth=depth, alpha=alpha)
    for name in ("canonical", "scale_2"):
        shutil.rmtree(folder / name)
    method = open_pictures("theirs", folder)
    assert method.tells == "depth"
    for row, before in zip(evaluate([method], [grown]), with_alpha, strict=True):
        assert row.scores["hole_rate"] == 0
        for name in ("see_through_rate", "spill"):
            assert row.scores[name] == pytest.approx(before.scores[name], abs=1e-6)
    np.savez(folder / "grown" / "r_0.npz", depth=depth)
    with pytest.raises(InputError, match=r"grown: expected opacity .* r_0 \(1 in this state\)"):
        open_pictures("theirs", folder).pose(grown)


def test_what_some_pictures_lack_is_an_error_that_names_them(
    folder: Path, states: SceneStates
) -> None:
    canonical, grown = states.select(["grown"])
    for path in folder.glob("*/*.png"):
        np.save(path.with_suffix(".npy"), np.full((24, 24), 3.0))
    (folder / "grown" / "r_1.npy").unlink()
    method = open_pictures("theirs", folder)
    assert method.tells == "depth"
    assert len(method.pose(canonical)) == 2
    with pytest.raises(InputError, match=r"grown: expected depth .* r_1 \(1 in this state\)"):
        method.pose(grown)
    Image.open(folder / "grown" / "r_0.png").convert("RGB").save(folder / "grown" / "r_0.png")
    with pytest.raises(InputError, match=r"grown: expected opacity of .* r_0 \(1 in"):
        open_pictures("theirs", folder).pose(grown)
    assert len(open_pictures("theirs", folder).pose(canonical)) == 2


def test_missing_and_misnamed_views_are_named(folder: Path, states: SceneStates) -> None:
    (folder / "grown" / "r_1.png").rename(folder / "grown" / "00001.png")
    method = open_pictures("theirs", folder)
    with pytest.raises(InputError) as caught:
        method.pose(states.select(["grown"])[1])
    assert "a picture for each of 2 test views, got none for r_1 (1 missing)" in str(caught.value)
    assert "files that no view is called after: 00001.png" in str(caught.value)
    with pytest.raises(InputError, match=r"folder walk .* got canonical, grown, scale_2"):
        method.pose(states.select(["walk"])[1])


def test_another_size_is_refused(folder: Path, states: SceneStates) -> None:
    path = folder / "canonical" / "r_0.png"
    Image.open(path).resize((48, 48)).save(path)
    method = open_pictures("theirs", folder)
    with pytest.raises(InputError, match=r"expected 24 x 24 pixels .* got 48 x 48; .*--factor"):
        evaluate([method], states.select([]))


def test_no_folder_and_no_pictures(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--pictures x=.*: expected a folder, found none"):
        open_pictures("x", tmp_path / "none")
    (tmp_path / "empty" / "canonical").mkdir(parents=True)
    with pytest.raises(InputError, match=r"STATE/VIEW\.png"):
        open_pictures("x", tmp_path / "empty")
    (tmp_path / "empty" / "canonical" / "r_0.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"r_0\.png"):
        open_pictures("x", tmp_path / "empty")


def test_a_damaged_picture_fails_its_own_state_and_capitals_are_endings(
    folder: Path, states: SceneStates
) -> None:
    for path in folder.glob("canonical/*.png"):
        path.rename(path.with_suffix(".PNG"))
    (folder / "grown" / "r_0.png").write_bytes(b"no picture")
    method = open_pictures("theirs", folder)
    assert method.tells == "opacity"
    canonical, grown = states.select(["grown"])
    (row, *_) = evaluate([method], [canonical])
    assert row.scores["psnr"] is not None
    with pytest.raises(InputError, match=r"r_0.png"):
        evaluate([method], [grown])
