"""`pcore check`: what it says, what it writes, what it refuses."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from rich.console import Console

from pcore.capture import triangulation
from pcore.capture.load import load_scene
from pcore.capture.mask_folder import write_masks
from pcore.capture.scene_masks import scene_masks
from pcore.capture.triangulation import PoseAgreement, Triangulated
from pcore.cli.check import CheckCommand, _looking_factor, commands_of
from pcore.cli.main import main
from pcore.data.pictures import write_mask
from pcore.data.points import save_points
from pcore.evaluation.check_page import check_page
from pcore.evaluation.scene_check import SceneCheck, check_scene
from pcore.training.locate import locate
from room_scene import HEIGHT, RADIUS, WIDTH, cameras, photos, picture, sparse_points, write_room

pytest.importorskip("cv2", reason="automatic masks need OpenCV")
BOX = ["--box", "-0.9", "-0.9", "-0.9", "0.9", "0.9", "0.9"]


@pytest.fixture(autouse=True)
def _no_timing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Timing real steps is what other tests are for."""
    monkeypatch.setattr("pcore.evaluation.scene_check.forecasts", lambda scene: ())


def _tree(folder: Path) -> dict[str, bytes]:
    return {str(p): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_it_says_what_was_found_and_leaves_the_folder_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room = write_room(tmp_path / "room", 16)
    (room / "images" / "0003.png").unlink()
    before = _tree(room)
    page = tmp_path / "report.html"
    assert main(["check", str(room), *BOX, "--html", str(page)]) == 0
    said = capsys.readouterr().out
    assert "15 photos" in said
    assert "skipped" in said
    assert "0003.png" in said
    assert "masks cut automatically agree with one hull" in said
    assert "by the box that was given" in said
    assert "15 of 15 photos are too far from others to compare exposure" in said
    assert "stands out by blur or exposure" not in said
    assert _tree(room) == before
    text = page.read_text()
    assert "<svg" in text
    assert "data:image/jpeg" in text
    assert "http" not in text.replace("http-equiv", "")


def test_a_turntable_before_a_room_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Poses are those of the object's own world; the camera and the room stood still."""
    room = write_room(tmp_path / "room", 12)
    behind, _ = picture(cameras(12)[0])
    for number, camera in enumerate(cameras(12)):
        rgb, mask = picture(camera)
        shown = torch.where(mask[..., None] > 0, rgb, behind)
        Image.fromarray((255 * shown).round().byte().numpy()).save(
            room / "images" / f"{number:04d}.png"
        )
    assert main(["check", str(room), *BOX]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "!! poses: the borders of all pictures show the same" in said
    assert "by these poses the room cannot be learned" in said
    assert "folded" not in said
    other = write_room(tmp_path / "other", 12)
    for bars in (0, 0.1, 0.13):  # Black ones of a film or of an undistorted picture last as well.
        for path in (other / "images").iterdir():
            pixels = np.array(Image.open(path))
            width = round(bars * pixels.shape[1])
            pixels[:, :width] = pixels[:, pixels.shape[1] - width :] = 0
            Image.fromarray(pixels).save(path)
        assert main(["check", str(other), *BOX]) == 0
        assert "borders of all" not in capsys.readouterr().out, bars


def test_masks_go_out_and_come_back(tmp_path: Path) -> None:
    room = write_room(tmp_path / "room", 12)
    masks = tmp_path / "masks"
    assert main(["check", str(room), *BOX, "--masks-out", str(masks)]) == 0
    assert sorted(p.name for p in masks.iterdir()) == [f"{i:04d}.png" for i in range(12)]
    scene = load_scene(room, masks=masks)
    assert 350 < float(scene.split("train")[0].alpha().sum()) < 550


def test_masks_are_those_that_a_training_cuts(tmp_path: Path) -> None:
    """Photos for tests have no vote, here and there: half of them would outvote the others."""
    room = write_room(tmp_path / "room", 12)
    written = json.loads((room / "transforms.json").read_text())
    names = [frame["file_path"] for frame in written["frames"]]
    written |= {"train_filenames": names[:6], "test_filenames": names[6:]}
    (room / "transforms.json").write_text(json.dumps(written))
    for name in names[6:]:
        Image.new("RGB", (WIDTH, HEIGHT), (20, 90, 110)).save(room / name)
    assert main(["check", str(room), *BOX, "--masks-out", str(tmp_path / "masks")]) == 0
    bare = locate(load_scene(room, masks="none"), torch.tensor([[-0.9] * 3, [0.9] * 3]))
    views, found = scene_masks(bare.scene, bare.region)
    write_masks(views, found.masks, tmp_path / "trained")
    here, there = _tree(tmp_path / "masks"), _tree(tmp_path / "trained")
    assert list(here.values()) == list(there.values())
    assert len(here) == 12


def test_the_page_is_written_where_there_are_no_masks_to_write(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room, page = write_room(tmp_path / "room", 9), tmp_path / "report.html"
    wide = ["--box", "-3", "-3", "-3", "3", "3", "3"]
    out = ["--html", str(page), "--masks-out", str(tmp_path / "masks")]
    assert main(["check", str(room), *wide, *out]) == 2
    assert "there are no masks to write" in capsys.readouterr().err
    assert "automatic masks: " in page.read_text()


def test_a_corrected_copy_is_a_scene_with_masks_cut_to_the_object(tmp_path: Path) -> None:
    room = write_room(tmp_path / "room", 12)
    points = sparse_points()
    save_points(room / "points.ply", points.positions)
    content = json.loads((room / "transforms.json").read_text())
    content["ply_file_path"] = "points.ply"
    (room / "transforms.json").write_text(json.dumps(content))
    fixed = tmp_path / "fixed"
    assert main(["check", str(room), *BOX, "--fix", str(fixed)]) == 0
    before, after = load_scene(room), load_scene(fixed)
    assert after.sparse is not None
    assert torch.equal(after.sparse.positions, points.positions)
    lower, upper = (torch.tensor([float(x) for x in BOX[i : i + 3]]) for i in (1, 4))
    assert after.region is not None
    assert torch.allclose(after.region.center, (lower + upper) / 2, atol=1e-5)
    assert [len(after.split(s)) for s in after.splits] == [
        len(before.split(s)) for s in ("train", "test")
    ]
    for view in after.split("train"):
        assert view.has_alpha
        assert view.camera.width < 48
        old = next(v for v in before.split("train") if v.name == view.name)
        place = torch.zeros(1, 3)
        column, row, _ = view.camera.project(place)
        there = old.camera.project(place)
        aside, above = (round(float(there[i] - at)) for i, at in enumerate((column, row)))
        own = view.rgba()[int(row), int(column)]
        # Not the pixel that the place falls into by each camera: it may lie between two.
        assert torch.allclose(own, old.rgba()[int(row) + above, int(column) + aside], atol=1 / 128)


@pytest.mark.parametrize("option", ["--fix", "--masks-out", "--html"])
@pytest.mark.parametrize("given", [".", "transforms.json"])
def test_nothing_is_written_into_the_scene(
    tmp_path: Path, option: str, given: str, capsys: pytest.CaptureFixture[str]
) -> None:
    room = write_room(tmp_path / "room", 9)
    before = _tree(room)
    assert main(["check", str(room / given), *BOX, option, str(room / "new")]) == 2
    assert "never written to" in capsys.readouterr().err
    assert _tree(room) == before


def test_corrected_masks_are_not_written_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room, masks = write_room(tmp_path / "room", 9), tmp_path / "masks"
    masks.mkdir()
    (masks / "mine.png").write_bytes(b"by hand")
    assert main(["check", str(room), *BOX, "--masks-out", str(masks)]) == 2
    assert "may have been corrected by hand" in " ".join(capsys.readouterr().err.split())
    assert [one.name for one in masks.iterdir()] == ["mine.png"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--box", "1", "2", "3"], "expected six numbers"),
        (["--box", "1", "0", "0", "0", "1", "1"], "lower corner below an upper"),
        (["--masks", "nowhere"], "no such folder"),
    ],
)
def test_bad_options_are_one_message(
    tmp_path: Path, options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    room = write_room(tmp_path / "room", 9)
    assert main(["check", str(room), *options]) == 2
    assert words in capsys.readouterr().err


def test_names_of_files_cannot_write_the_page(tmp_path: Path) -> None:
    room = write_room(tmp_path / "<b>room", 9)
    scene = load_scene(room)
    found: SceneCheck = check_scene(scene, scene)
    page = check_page(found, ["pcore train <x>"])
    assert "<b>room" not in page
    assert "<x>" not in page


def test_a_scene_without_masks_is_told_to_have_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room = write_room(tmp_path / "room", 9)
    assert main(["check", str(room), "--masks", "none"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "the photos have no masks" in said
    assert "9 photos are few" in said


def test_masks_that_hold_the_whole_picture_are_told_to_be_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room, masks = write_room(tmp_path / "room", 9), tmp_path / "masks"
    assert main(["check", str(room), *BOX, "--masks-out", str(masks)]) == 0
    for path in masks.iterdir():
        with Image.open(path) as mask:
            size = mask.size
        Image.new("L", size, 255).save(path)
    capsys.readouterr()
    assert main(["check", str(room), *BOX, "--masks", str(masks)]) == 0
    assert "holds the whole picture: it is no mask" in capsys.readouterr().out


def test_a_wrong_mask_among_given_ones_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room = write_room(tmp_path / "room", 24)
    folder = tmp_path / "cut"
    folder.mkdir()
    for number, camera in enumerate(cameras(24)):
        mask = picture(camera)[1]
        write_mask(folder / f"{number:04d}.png", mask.roll(14, dims=1) if number == 5 else mask)
    assert main(["check", str(room), *BOX, "--masks", str(folder)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "1 of 24 photos (0005) is doubtful" in said


def test_an_edit_of_a_scene_with_its_background_is_told_to_need_a_region(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room = write_room(tmp_path / "room", 9)
    assert main(["check", str(room), "--masks", "none", *BOX]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert (
        '"region": {"shape": "box", "lower": [-0.9, -0.9, -0.9], "upper": [0.9, 0.9, 0.9]}' in said
    )


def test_masks_in_the_region_of_the_axes_say_where_the_object_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room = write_room(tmp_path / "room", 12)
    (tmp_path / "masks").mkdir()
    for number, camera in enumerate(cameras(12)):
        write_mask(tmp_path / "masks" / f"{number:04d}.png", picture(camera)[1])
    assert main(["check", str(room), "--masks", str(tmp_path / "masks")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    found = re.search(r"the hull of the masks in it reaches over \((.*?)\) to", said)
    assert found is not None
    lower = [float(x) for x in found[1].split(",")]
    assert max(abs(x + RADIUS) for x in lower[:2]) < 0.15


def test_pictures_of_a_corrected_copy_have_one_size(tmp_path: Path) -> None:
    room = write_room(tmp_path / "room", 12)
    masks = tmp_path / "masks"
    masks.mkdir()
    for number, camera in enumerate(cameras(12)):
        mask = picture(camera)[1]
        mask[:, : 20 + number] = 0  # Every mask has another width.
        write_mask(masks / f"{number:04d}.png", mask)
    fixed = tmp_path / "fixed"
    assert main(["check", str(room), "--masks", str(masks), "--fix", str(fixed)]) == 0
    scene = load_scene(fixed)
    views = [view for name in scene.splits for view in scene.split(name)]
    assert len({(view.camera.width, view.camera.height) for view in views}) == 1
    before = {v.name: v for name in ("train", "test") for v in load_scene(room).split(name)}
    for view in views:
        column, row, _ = view.camera.project(torch.zeros(1, 3))
        there = before[view.name].camera.project(torch.zeros(1, 3))
        assert float(column - there[0]) == pytest.approx(round(float(column - there[0])), abs=1e-3)
        assert float(row - there[1]) == pytest.approx(round(float(row - there[1])), abs=1e-3)


@pytest.mark.parametrize(
    ("median", "words"), [(0.2, "ok pose check"), (3.0, "The poses are not those of these photos")]
)
def test_poses_are_held_against_features(
    tmp_path: Path,
    median: float,
    words: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = PoseAgreement(median=median, of_views=(median,) * 9, pairs=20, points=600)
    monkeypatch.setattr(
        triangulation,
        "triangulated",
        lambda scene, _: Triangulated(
            scene=replace(scene, sparse=sparse_points()), agreement=found
        ),
    )
    room = write_room(tmp_path / "room", 9)
    assert main(["check", str(room), "--masks", "none", "--triangulate"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert words in said
    assert "the dense part of the sparse points" in said
    assert "reprojection" not in said
    fixed = tmp_path / "fixed"
    words = ["--masks", "none", "--triangulate", "--fix", str(fixed)]
    if median < 1:
        assert main(["check", str(room), *words]) == 0
        kept = load_scene(fixed).sparse
        assert kept is not None
        assert len(kept) == len(sparse_points())


@pytest.mark.parametrize(
    ("value", "words"),
    [(0.0, "nothing to learn; are the masks black"), (1.0, "98 % of the picture")],
)
def test_masks_of_nothing_and_of_everything_are_not_called_good(
    tmp_path: Path, value: float, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    room = write_room(tmp_path / "room", 9)
    (tmp_path / "cut").mkdir()
    for number in range(9):
        mask = torch.full((48, 64), value)
        mask[0, :] = 0  # One row of background: masks without any are those of plain photos.
        write_mask(tmp_path / "cut" / f"{number:04d}.png", mask)
    assert main(["check", str(room), *BOX, "--masks", str(tmp_path / "cut")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert words in said
    assert "ok masks" not in said


def test_a_lost_mask_is_no_doubt_about_the_others(tmp_path: Path) -> None:
    room = write_room(tmp_path / "room", 12)
    (tmp_path / "cut").mkdir()
    for number, mask in enumerate(photos(12)[1]):
        write_mask(tmp_path / "cut" / f"{number:04d}.png", mask * (number != 5))
    scene = load_scene(room, masks=tmp_path / "cut")
    found = check_scene(scene, scene)
    assert found.masks is not None
    assert found.masks.doubtful() == (5,)
    assert min(*found.masks.agreement[:5], *found.masks.agreement[6:]) > 0.8
    assert float((found.region.center).norm()) < 0.5


def test_photos_of_one_name_in_two_splits_keep_their_own_masks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those of other splits of a rendered scene have none, and are not cut with another's."""
    room = write_room(tmp_path / "room", 9)
    content = json.loads((room / "transforms.json").read_text())
    for split, frames in (("train", content["frames"]), ("test", content["frames"][3:5])):
        (room / split).mkdir()
        for number, frame in enumerate(frames):
            photo = room / split / f"{number}.png"
            shutil.copy(room / frame["file_path"], photo)
        own = [{**frame, "file_path": f"{split}/{i}.png"} for i, frame in enumerate(frames)]
        (room / f"transforms_{split}.json").write_text(json.dumps({**content, "frames": own}))
    (room / "transforms.json").unlink()
    assert main(["check", str(room), *BOX, "--fix", str(tmp_path / "fixed")]) == 0
    assert "without 2 photos of other splits" in capsys.readouterr().out
    fixed = load_scene(tmp_path / "fixed")
    assert sum(len(fixed.split(name)) for name in fixed.splits) == 9


def test_photos_of_captures_are_looked_at_small_whatever_divides_them(tmp_path: Path) -> None:
    room = write_room(tmp_path / "room", 9)
    content = json.loads((room / "transforms.json").read_text())
    for frame in content["frames"]:
        with Image.open(room / frame["file_path"]) as photo:
            photo.resize((1009, 757)).save(room / frame["file_path"])  # Both are primes.
    assert _looking_factor(room, Console()) == 3


def test_a_capture_whose_exposure_drifts_is_trained_with_colours_of_each_view(
    tmp_path: Path,
) -> None:
    room = load_scene(write_room(tmp_path / "room", 9))
    found = check_scene(room, room)
    drifting = replace(found.quality, stops=torch.linspace(0, 2, 9)[:, None].expand(-1, 3))
    said = [
        commands_of(replace(found, quality=one), CheckCommand(scene=Path("room")), 1)[0]
        for one in (found.quality, drifting)
    ]
    assert ["--exposure per-view" in line for line in said] == [False, True]
