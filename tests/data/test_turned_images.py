"""EXIF turns: taken as the scene file's size says, else refused, never told to resize."""

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import ExifTags, Image

from pcore.capture.load import load_scene
from pcore.data.image_files import read_header, read_rgba
from pcore.errors import SceneError
from scene_files import change, change_frame


def turn(root: Path, orientation: int, *, ending: str = "jpg", size: tuple[int, int] = (12, 8)):
    """Give all images an EXIF orientation, as phones do."""
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    for index in range(3):
        path = root / "train" / f"r_{index}.png"
        image = Image.open(path).convert("RGB").resize(size)
        path.unlink()
        image.save(path.with_suffix(f".{ending}"), exif=exif, quality=95)
        change_frame(root / "transforms_train.json", index, file_path=f"train/r_{index}.{ending}")


@pytest.mark.parametrize("orientation", [5, 6, 7, 8])
@pytest.mark.parametrize("ending", ["jpg", "png", "webp"])
def test_the_size_in_the_file_tells_what_the_cameras_are_for(
    scene: Path, orientation: int, ending: str
) -> None:
    turn(scene, orientation, ending=ending)
    path = scene / "transforms_train.json"
    image = scene / "train" / f"r_0.{ending}"
    change(path, w=8, h=12)  # As viewers show it.
    loaded = load_scene(scene)
    view = loaded.split("train")[0]
    assert (view.camera.width, view.camera.height) == (8, 12)
    assert torch.equal(view.rgba(), read_rgba(image, upright=True))
    assert loaded.notes == ("3 of 3 images are turned by their EXIF tag, as 'w' and 'h' say",)
    change(path, w=12, h=8)  # As it is stored, which COLMAP takes.
    loaded = load_scene(scene)
    view = loaded.split("train")[0]
    assert (view.camera.width, view.camera.height) == (12, 8)
    assert torch.equal(view.rgba(), read_rgba(image))
    assert loaded.notes == ()


def test_upright_is_as_viewers_turn_it(tmp_path: Path) -> None:
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6  # The camera was turned: rotate by 90 degrees clockwise.
    Image.fromarray(pixels).save(tmp_path / "a.png", exif=exif)
    assert read_header(tmp_path / "a.png").upright_size == (2, 4)
    upright = read_rgba(tmp_path / "a.png", upright=True)
    expected = np.rot90(pixels, k=-1) / np.float32(255)
    assert torch.equal(upright[..., :3], torch.from_numpy(expected.copy()).float())


@pytest.mark.parametrize("orientation", [2, 3, 4, 5, 6, 7, 8])
@pytest.mark.parametrize("size", [(12, 8), (8, 8)])
def test_without_a_size_it_is_an_error_that_names_the_tag(
    scene: Path, orientation: int, size: tuple[int, int]
) -> None:
    turn(scene, orientation, size=size)
    with pytest.raises(SceneError) as caught:
        load_scene(scene)
    message = str(caught.value)
    assert (
        f"frame 0 (train/r_0.jpg): the image is turned by its EXIF tag (orientation {orientation})"
        in message
    )
    assert "mogrify -auto-orient" in message
    assert "resize" not in message
    can_tell = size == (12, 8) and orientation > 4
    assert ("8 x 12 as viewers show it, 12 x 8 as it is stored" in message) == can_tell


def test_a_third_size_is_refused_for_the_tag(scene: Path) -> None:
    turn(scene, 6)
    change(scene / "transforms_train.json", w=16, h=24)
    with pytest.raises(SceneError, match="turned by its EXIF tag"):
        load_scene(scene)


def test_images_that_are_not_turned_need_no_size(scene: Path) -> None:
    turn(scene, 1)
    assert load_scene(scene).notes == ()


def test_a_damaged_tag_turns_nothing(scene: Path) -> None:
    for index in range(3):
        path = scene / "train" / f"r_{index}.png"
        Image.open(path).convert("RGB").save(path.with_suffix(".jpg"), exif=b"Exif\0\0damaged")
        path.unlink()
        change_frame(scene / "transforms_train.json", index, file_path=f"train/r_{index}.jpg")
    assert len(load_scene(scene).split("train")) == 3
