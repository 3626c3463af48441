"""Masks from a folder: by name, by order, and what is refused."""

from pathlib import Path

import pytest
import torch
from PIL import Image

from pcore.capture.load import load_scene
from pcore.capture.mask_folder import match_masks, write_masks
from pcore.errors import SceneError
from room_scene import HEIGHT, WIDTH, write_room


def _mask(path: Path, value: int = 255) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    picture = Image.new("L", (WIDTH, HEIGHT), 0)
    picture.paste(value, (10, 10, 40, 40))
    picture.save(path)


def test_masks_are_taken_by_name(tmp_path: Path) -> None:
    room = write_room(tmp_path / "room", 9)
    for number in range(9):
        _mask(tmp_path / "cut" / f"{number:04d}.png")
    scene = load_scene(room, masks=tmp_path / "cut")
    for split in scene.splits:
        for view in scene.split(split):
            assert view.has_alpha
            assert [float(view.alpha()[i, i]) for i in (20, 0)] == [1, 0]
    assert scene.masks == tmp_path / "cut"
    assert any("9 by name" in note for note in scene.notes)


def test_names_of_no_photo_are_taken_by_order_and_that_is_said(tmp_path: Path) -> None:
    photos = [tmp_path / f"img_{i}.jpg" for i in (2, 10, 1)]
    for number in range(3):
        _mask(tmp_path / "cut" / f"{number:03d}.png")
    found = match_masks(photos, tmp_path / "cut")
    assert "by order" in found.note
    assert [found.files[photo].stem for photo in photos] == ["001", "002", "000"]


def test_names_with_two_endings_and_sub_folders_fit(tmp_path: Path) -> None:
    photos = [tmp_path / side / "1.jpg" for side in ("left", "right")]
    for side in ("left", "right"):
        _mask(tmp_path / "cut" / side / "1.jpg.png")
    found = match_masks(photos, tmp_path / "cut")
    assert [found.files[photo].parent.name for photo in photos] == ["left", "right"]


def test_missing_masks_are_named(tmp_path: Path) -> None:
    _mask(tmp_path / "cut" / "a.png")
    with pytest.raises(SceneError, match=r"without one are b\.jpg \(1 in all\)"):
        match_masks([tmp_path / "a.jpg", tmp_path / "b.jpg"], tmp_path / "cut")
    with pytest.raises(SceneError, match="no such folder"):
        match_masks([tmp_path / "a.jpg"], tmp_path / "none")


def test_a_mask_of_another_size_is_refused(tmp_path: Path) -> None:
    room = write_room(tmp_path / "room", 9)
    for number in range(9):
        _mask(tmp_path / "cut" / f"{number:04d}.png")
    Image.new("L", (WIDTH + 1, HEIGHT)).save(tmp_path / "cut" / "0003.png")
    scene = load_scene(room, masks=tmp_path / "cut")
    with pytest.raises(SceneError, match=r"mask .*0003\.png: expected 64 x 48 pixels"):
        [view.rgba() for split in scene.splits for view in scene.split(split)]


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    scene = load_scene(write_room(tmp_path / "room", 9))
    views = [view for split in scene.splits for view in scene.split(split)]
    masks = [torch.rand(HEIGHT, WIDTH, generator=torch.Generator().manual_seed(0)) for _ in views]
    write_masks(views, masks, tmp_path / "cut")
    again = load_scene(tmp_path / "room", masks=tmp_path / "cut")
    known = dict(zip((view.name for view in views), masks, strict=True))
    for split in again.splits:
        for view in again.split(split):
            assert torch.allclose(view.alpha(), known[view.name], atol=1 / 255)
