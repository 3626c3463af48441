"""Images under names as other systems spell them; all that are missing are named at once."""

import unicodedata
from pathlib import Path

import pytest
from PIL import Image

from pcore.capture.load import load_cameras, load_scene
from pcore.errors import SceneError
from scene_files import change_frame, write_split

NFC, NFD = (unicodedata.normalize(form, "Gerät_ö") for form in ("NFC", "NFD"))


@pytest.fixture
def path(scene: Path) -> Path:
    return scene / "transforms_train.json"


def rename(scene: Path, name: str, new: str) -> None:
    (scene / new).parent.mkdir(exist_ok=True, parents=True)
    (scene / name).rename(scene / new)


@pytest.mark.parametrize(
    ("file", "written", "note"),
    [
        # Windows' separators (faults/19), which instant-ngp replaces as well.
        ("train/r_1.png", "train\\r_1.png", "backslashes are read as slashes"),
        ("train/r_1.png", ".\\train\\r_1", "images end in .png"),
        ("deep/er/r_1.png", "deep\\er\\r_1.png", "backslashes are read as slashes"),
        # macOS decomposes letters, Linux keeps what it is given.
        (f"train/{NFD}.png", f"train/{NFC}.png", "another Unicode form"),
        (f"train/{NFC}.png", f"train/{NFD}", "images end in .png"),
        (f"{NFD}/r_1.png", f"{NFC}/r_1.png", "another Unicode form"),
        # Cameras write DSC_1.JPG, Windows and macOS do not tell cases apart.
        ("train/R_1.PNG", "train/r_1.png", "other case"),
        ("train/r_1.png", "Train/R_1.png", "other case"),
        ("train/r_1.PNG", "train/r_1", "images end in .PNG"),
        # The photos were converted, the file was not.
        ("train/r_1.png", "train/r_1.jpg", "images end in .png and not in .jpg"),
        ("train/r_1.png", "train/r_1.JPEG", "images end in .png and not in .jpeg"),
        ("train/r_1.webp", "train/r_1.png", "images end in .webp and not in .png"),
        ("train/r_1.png", "train\\R_1.jpg", "images end in .png and not in .jpg"),
    ],
)
def test_other_spellings_are_found_and_told_of(
    scene: Path, path: Path, file: str, written: str, note: str
) -> None:
    if file.endswith(".webp"):
        Image.open(scene / "train" / "r_1.png").save(scene / file, lossless=True)
        (scene / "train" / "r_1.png").unlink()
    else:
        rename(scene, "train/r_1.png", file)
    change_frame(path, 1, file_path=written)
    loaded = load_scene(scene)
    assert loaded.split("train")[1].image.path == (scene / file).resolve()
    (said,) = loaded.notes
    assert note in said
    assert said.endswith("in 1 names")


@pytest.mark.parametrize(
    ("file", "written"),
    [
        ("train/r_1.jpg", "train/r_1"),
        ("train/r_1.jpeg", "./train/r_1"),
        ("train/r_1.v2.png", "train/r_1.v2"),
        ("train/r 1.png", "train/r 1.png"),
        ("train/a\\b.png", "train/a\\b.png"),  # A file of that name, which Linux allows.
        ("r_1.png", "train/../r_1.png"),
    ],
)
def test_names_as_they_are_written_go_first(
    scene: Path, path: Path, file: str, written: str
) -> None:
    rename(scene, "train/r_1.png", file)
    change_frame(path, 1, file_path=written)
    loaded = load_scene(scene)
    assert loaded.split("train")[1].image.path == (scene / file).resolve()
    assert loaded.notes == ()


def test_a_name_that_fits_two_files_is_refused(scene: Path, path: Path) -> None:
    rename(scene, "train/r_1.png", "train/R_2.PNG")
    rename(scene, "train/r_2.png", "train/r_2.PNG")
    change_frame(path, 1, file_path="train/r_2.Png")
    with pytest.raises(
        SceneError, match=r"'R_2.PNG' and 'r_2.PNG' have nearly that name; write wh"
    ):
        load_scene(scene)


@pytest.mark.parametrize(
    "written", ["..\\secret.png", "train\\..\\..\\secret.png", "../SECRET.png"]
)
def test_other_spellings_do_not_leave_the_scene(scene: Path, path: Path, written: str) -> None:
    Image.new("RGBA", (12, 8)).save(scene.parent / "secret.png")
    change_frame(path, 0, file_path=written)
    with pytest.raises(SceneError, match=r"frame 0 .*'file_path' leaves the scene's folder"):
        load_scene(scene)


# --- missing ------------------------------------------------------------------------------------


def test_all_missing_images_are_named_with_their_number(tmp_path: Path) -> None:
    write_split(tmp_path, "train", count=7)
    for index in (1, 4, 5):
        (tmp_path / "train" / f"r_{index}.png").unlink()
    with pytest.raises(SceneError) as caught:
        load_scene(tmp_path)
    message = str(caught.value)
    assert "transforms_train.json: no image at the place that 3 of 7 frames name" in message
    assert "./train/r_1, ./train/r_4, ./train/r_5; put them there" in message


def test_a_long_list_is_cut_and_counted(tmp_path: Path) -> None:
    write_split(tmp_path, "train", count=30)
    for path in (tmp_path / "train").iterdir():
        path.unlink()
    with pytest.raises(SceneError, match=r"30 of 30 frames name.*r_19 and 10 more; put them there"):
        load_scene(tmp_path)


@pytest.mark.parametrize(
    "written",
    [
        "images/r_1.png",  # another folder
        "r_1",
        "C:\\Users\\me\\scan\\images\\r_1.png",
        "/home/me/scan/images/r_1.jpg",
        "..\\images\\r_1.png",
    ],
)
def test_where_a_missing_image_lies_is_said(scene: Path, path: Path, written: str) -> None:
    for index in range(3):
        change_frame(path, index, file_path=written.replace("r_1", f"r_{index}"))
    with pytest.raises(SceneError, match=r"is there: .*train/r_[01].png; write it so, rela"):
        load_scene(scene)


def test_cameras_are_named_after_windows_paths_too(path: Path) -> None:
    change_frame(path, 0, file_path="C:\\scan\\left\\a b.png")
    names = [name for name, _ in load_cameras(path, width=4, height=4)]
    assert names == ["a_b", "r_1", "r_2"]
