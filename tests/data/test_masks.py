"""Masks: those of `mask_path` are alpha; masks that hold everything or nothing are told of."""

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from pcore.capture.load import load_scene
from pcore.data.masks import check_masks
from pcore.errors import SceneError
from scene_files import change, change_frame, write_split

DISC = np.zeros((8, 12), dtype=np.uint8)
DISC[2:6, 3:9] = 255


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    """A scene of RGB images."""
    root = tmp_path / "photos"
    write_split(root, "train", mode="RGB")
    return root


def save_masks(root: Path, mask: Image.Image, *, name: str = "masks/r_{}.png") -> None:
    """The same mask for every frame, named by `mask_path`."""
    for index in range(3):
        path = root / name.format(index)
        path.parent.mkdir(exist_ok=True)
        mask.save(path)
        change_frame(root / "transforms_train.json", index, mask_path=name.format(index))


def save_alpha(root: Path, *alphas: np.ndarray) -> None:
    for index, alpha in enumerate(alphas):
        path = root / "train" / f"r_{index}.png"
        image = Image.open(path).convert("RGB")
        image.putalpha(Image.fromarray(alpha))
        image.save(path)


# --- mask_path (faults/11 and kin) --------------------------------------------------------------


def as_palette() -> Image.Image:
    """A mask of labels, as labelling tools write them: index 1 is dark red."""
    image = Image.fromarray((DISC > 0).astype(np.uint8)).convert("P")
    image.putpalette([0, 0, 0, 128, 0, 0] + [0] * 762)
    return image


MASKS = {
    "gray": Image.fromarray(DISC),
    "one bit": Image.fromarray(DISC).convert("1"),
    "colour": Image.fromarray(DISC).convert("RGB"),
    "zero and one": Image.fromarray((DISC > 0).astype(np.uint8)),
    "palette": as_palette(),
    "transparent background": Image.merge(
        "RGBA", [Image.new("L", (12, 8), 255)] * 3 + [Image.fromarray(DISC)]
    ),
}


@pytest.mark.parametrize("kind", MASKS)
def test_a_mask_is_the_alpha_of_its_image(photos: Path, kind: str) -> None:
    before = load_scene(photos).split("train")[0].rgba()
    save_masks(photos, MASKS[kind])
    loaded = load_scene(photos)
    view = loaded.split("train")[0]
    assert view.has_alpha
    assert torch.equal(view.alpha(), torch.from_numpy(DISC / 255).float())
    assert torch.equal(view.rgba()[..., :3], before[..., :3])
    assert loaded.notes == ()
    half = load_scene(photos, factor=2).split("train")[0].alpha()
    assert half[1, 2:4].tolist() == [1.0, 1.0]
    assert half[1, 1] == 0.5  # Half of its four pixels.


def test_soft_masks_stay_soft(photos: Path) -> None:
    soft = DISC.copy()
    soft[2] = soft[2] // 2
    save_masks(photos, Image.fromarray(soft))
    assert load_scene(photos).split("train")[0].alpha()[2, 4] == pytest.approx(127 / 255)


def test_one_mask_for_all_frames(photos: Path) -> None:
    # nerfstudio writes one mask file for all frames of a cropped fisheye; here at the top.
    Image.fromarray(DISC).save(photos / "mask.png")
    change(photos / "transforms_train.json", mask_path="./mask.png")
    assert all(float(view.alpha().mean()) == 0.25 for view in load_scene(photos).split("train"))


def test_a_mask_narrows_an_alpha_channel(photos: Path) -> None:
    save_alpha(photos, *[np.full((8, 12), 51, dtype=np.uint8)] * 3)
    save_masks(photos, Image.fromarray(DISC))
    alpha = load_scene(photos).split("train")[0].alpha()
    assert (float(alpha.max()), float(alpha.min())) == (pytest.approx(0.2), 0.0)


@pytest.mark.parametrize(
    ("mask_path", "message"),
    [
        ("masks/none.png", r"frame 1 .*no mask at .*masks/none.png"),
        ("../mask.png", r"frame 1 .*'mask_path' leaves the scene's folder"),
        ("masks/small.png", r"mask .*small.png: expected 12 x 8 pixels as its image has, got 6 x"),
        ("masks/text.png", r"text.png: expected an image such as PNG"),
        (None, r"expected 'mask_path' in every frame or in none, got it in 2 of 3; .*frame 1"),
    ],
)
def test_masks_that_cannot_be_used(photos: Path, mask_path: str | None, message: str) -> None:
    save_masks(photos, Image.fromarray(DISC))
    Image.new("L", (6, 6)).save(photos / "masks" / "small.png")
    (photos / "masks" / "text.png").write_text("no image")
    change_frame(photos / "transforms_train.json", 1, mask_path=mask_path)
    with pytest.raises(SceneError, match=message):
        [view.rgba() for view in load_scene(photos).split("train")]


@pytest.mark.parametrize(
    "name",
    [
        "masks/r_0.png",  # nerfstudio
        "masks/r_0.png.png",  # COLMAP
        "mask/r_0.png",
        "train/dynamic_mask_r_0.png",  # instant-ngp
        "train/r_0.alpha.png",  # instant-ngp
    ],
)
def test_masks_beside_the_images_are_pointed_out(photos: Path, name: str) -> None:
    path = photos / name
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(DISC).save(path)
    (note,) = load_scene(photos).notes
    assert note == (
        f"{name} looks like a mask and is not used: name it by 'mask_path' in its frame (white is "
        "object)"
    )


# --- masks that hold everything or nothing (faults/10 and kin) ----------------------------------

FULL, EMPTY = np.full((8, 12), 255, dtype=np.uint8), np.zeros((8, 12), dtype=np.uint8)
NEARLY_FULL, NEARLY_EMPTY = FULL - 1, EMPTY + 3


@pytest.mark.parametrize("alpha", [FULL, NEARLY_FULL], ids=["255", "254"])
def test_an_alpha_that_holds_the_whole_picture_is_no_mask(photos: Path, alpha: np.ndarray) -> None:
    save_alpha(photos, alpha, alpha, alpha)
    views = load_scene(photos).split("train")
    assert not any(view.has_alpha for view in views)
    (note,) = check_masks(views)
    assert "the alpha of all 3 images holds the whole picture: it is no mask" in note


def test_masks_of_some_images_that_hold_everything_or_nothing(photos: Path) -> None:
    save_alpha(photos, FULL, DISC, EMPTY)
    views = load_scene(photos).split("train")
    assert all(view.has_alpha for view in views)
    whole, empty = check_masks(views)
    assert "1 of 3 (r_0) images hold the whole picture" in whole
    assert "1 of 3 (r_2) images hold nothing" in empty


@pytest.mark.parametrize("alpha", [EMPTY, NEARLY_EMPTY], ids=["0", "3"])
@pytest.mark.parametrize("way", ["alpha", "mask"])
def test_masks_that_hold_nothing_at_all(photos: Path, alpha: np.ndarray, way: str) -> None:
    if way == "alpha":
        save_alpha(photos, alpha, alpha, alpha)
    else:
        save_masks(photos, Image.fromarray(np.where(DISC, alpha, 0).astype(np.uint8)))
    views = load_scene(photos).split("train")
    if way == "mask" and alpha.any():
        assert check_masks(views) == ()  # Two values: 0 and 3 are background and object.
        return
    with pytest.raises(SceneError, match="got 3 images that are transparent all over"):
        check_masks(views)


def test_photos_without_alpha_and_clean_masks_have_no_notes(photos: Path) -> None:
    assert check_masks(load_scene(photos).split("train")) == ()
    save_alpha(photos, DISC, DISC, DISC)
    assert check_masks(load_scene(photos).split("train")) == ()


def test_one_picture_tells_that_alpha_is_a_mask(photos: Path) -> None:
    save_alpha(photos, DISC, DISC, DISC)
    views = load_scene(photos).split("train")
    assert all(view.has_alpha for view in views)
    assert views[0].image.cache.bytes_used == 8 * 12 * 4 * 4
