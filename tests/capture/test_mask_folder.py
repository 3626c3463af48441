"""Masks from a folder: by name, by order, and what is refused."""

from pathlib import Path

import pytest
import torch
from PIL import Image

from capture_files import shots, write_model, write_photos
from pcore.capture.load import load_scene
from pcore.capture.mask_folder import match_masks, write_masks
from pcore.data.image_files import read_mask
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


@pytest.mark.parametrize("written", ["cam0", ""])
def test_masks_that_fit_photos_of_two_cameras_are_no_masks(tmp_path: Path, written: str) -> None:
    photos = [tmp_path / "images" / f"cam{side}" / f"{i}.png" for i in range(3) for side in (0, 1)]
    for number in range(3):
        _mask(tmp_path / "cut" / written / f"{number}.png")
    count = 3 if written else 6
    with pytest.raises(SceneError, match=rf"cam1/0\.png.*\({count} in all\).*put their masks into"):
        match_masks(photos, tmp_path / "cut")
    for number in range(6):  # As many as photos: names that fit in part are no reason to guess.
        _mask(tmp_path / "cut" / written / f"{number}.png")
    with pytest.raises(SceneError, match=rf"\({count} in all\)"):
        match_masks(photos, tmp_path / "cut")


def test_photos_of_one_name_but_for_the_ending_have_their_own_masks(tmp_path: Path) -> None:
    photos = [tmp_path / "a.jpg", tmp_path / "a.png"]
    for photo in photos:
        _mask(tmp_path / "cut" / f"{photo.name}.png")
    found = match_masks(photos, tmp_path / "cut").files
    assert [found[photo].stem for photo in photos] == ["a.jpg", "a.png"]


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
    generator = torch.Generator().manual_seed(0)
    masks = [
        torch.randint(256, (HEIGHT, WIDTH), generator=generator, dtype=torch.uint8) for _ in views
    ]
    write_masks(views, masks, tmp_path / "cut")
    again = load_scene(tmp_path / "room", masks=tmp_path / "cut")
    known = dict(zip((view.name for view in views), masks, strict=True))
    for split in again.splits:
        for view in again.split(split):
            assert torch.allclose(view.alpha(), known[view.name] / 255, atol=1 / 255)


def test_photos_of_one_name_have_masks_in_folders_of_their_own(tmp_path: Path) -> None:
    photos = shots(6)
    for number, shot in enumerate(photos):
        shot.name = f"cam{number % 2}/{number // 2:04d}.png"
    write_photos(tmp_path / "rig" / "images", [shot.name for shot in photos])
    write_model(tmp_path / "rig" / "sparse" / "0", photos)
    views = load_scene(tmp_path / "rig").split("train")
    masks = list(255 * torch.eye(24).byte()[: len(views), None].expand(-1, 16, -1))
    write_masks(views, masks, tmp_path / "cut")
    found = match_masks([view.image.path for view in views], tmp_path / "cut").files
    read = [read_mask(found[view.image.path], size=(24, 16)) for view in views]
    assert all(torch.equal(one, other / 255) for one, other in zip(read, masks, strict=True))


@pytest.mark.parametrize("size", [(WIDTH // 2, HEIGHT // 2), (3 * WIDTH, 3 * HEIGHT)])
def test_masks_of_scaled_photos_fit(tmp_path: Path, size: tuple[int, int]) -> None:
    _mask(tmp_path / "mask.png")
    Image.open(tmp_path / "mask.png").resize(size, Image.Resampling.BOX).save(tmp_path / "s.png")
    mask = read_mask(tmp_path / "s.png", size=(WIDTH, HEIGHT))
    assert torch.equal(mask, read_mask(tmp_path / "mask.png", size=(WIDTH, HEIGHT)))
