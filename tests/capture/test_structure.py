"""Photos and videos without poses: the child process, its limits and what is kept of it."""

import json
import struct
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image, PngImagePlugin

from capture_files import write_photos
from pcore.capture import structure
from pcore.capture.layouts import layout_of
from pcore.capture.load import has_poses, load_scene
from pcore.capture.structure import Patience, with_poses
from pcore.capture.video_frames import choose_frames, scenes_of
from pcore.errors import DependencyError, SceneError

FAKE = """
import json, sys
sys.path[:0] = {paths!r}
from pathlib import Path
from capture_files import shots, write_model
wish = json.loads(sys.argv[1])
print("pcore: looking for features", flush=True)
names = sum(wish["cameras"], [])
all = shots(len(names))
for shot, name in zip(all, names):
    shot.name = name
write_model(Path(wish["output"]) / "0", all[:2])
write_model(Path(wish["output"]) / "1", all)
"""


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def child(monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    monkeypatch.setattr(structure, "CHILD", (sys.executable, "-c", code))
    monkeypatch.setattr(structure.importlib.util, "find_spec", lambda _: object())


def fake(monkeypatch: pytest.MonkeyPatch) -> None:
    child(monkeypatch, FAKE.format(paths=[path for path in sys.path if "tests" in path]))


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "holiday"
    write_photos(folder, [f"IMG_{i}.jpg" for i in range(10)])
    return folder


def test_the_largest_model_is_taken_and_kept(photos: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake(monkeypatch)
    heard: list[str] = []
    before = sorted(photos.rglob("*"))
    scene = load_scene(photos, tell=heard.append)
    assert scene.layout == "COLMAP"
    assert sum(len(split) for split in scene.views.values()) == 10
    assert heard == ["looking for features"]
    assert sorted(photos.rglob("*")) == before
    assert any("1 is the largest model, with 10 images" in note for note in scene.notes)
    child(monkeypatch, "raise SystemExit('the model is kept')")
    assert len(load_scene(photos).split("train")) == 8
    write_photos(photos, ["IMG_11.jpg"])  # Other photos: the model is not theirs.
    with pytest.raises(SceneError, match="the model is kept"):
        load_scene(photos)


def test_what_was_posed_before_worlds_stood_upright_keeps_its_world(
    photos: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Runs that were trained on it record the folder of the photos alone."""
    fake(monkeypatch)
    assert not has_poses(photos)
    load_scene(photos)
    (place,) = structure.cache_folder().glob("*-upright")
    older = place.rename(place.with_name(place.name.removesuffix("-upright")))
    child(monkeypatch, "raise SystemExit('posed again')")
    assert has_poses(photos)
    assert load_scene(photos).layout == "COLMAP"
    assert older.is_dir()


@pytest.mark.parametrize(
    ("patience", "message"),
    [
        (Patience(whole=0.3), r"was ended after 0\.3 s;"),
        (Patience(silence=0.3), r"was ended after 0\.3 s in which it said nothing"),
    ],
)
def test_a_child_that_hangs_is_ended(
    patience: Patience, message: str, photos: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = "import signal, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\ntime.sleep(60)"
    child(monkeypatch, code)
    began = time.monotonic()
    with pytest.raises(SceneError, match=message):
        with_poses(layout_of(photos), print, patience)
    assert time.monotonic() - began < 30
    assert not list((photos.parent / "cache").rglob("unfinished-*"))


def test_a_child_that_crashes_is_told_of(photos: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    child(monkeypatch, "import os\nprint('corrupted size', flush=True)\nos.abort()")
    with pytest.raises(SceneError, match=r"ended with code -6 .*corrupted size"):
        load_scene(photos)


def test_photos_without_common_structure(photos: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    child(monkeypatch, "pass")
    with pytest.raises(SceneError, match="no common structure in 10 photos"):
        load_scene(photos)


def test_too_few_photos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake(monkeypatch)
    write_photos(tmp_path / "few", ["a.jpg"])
    with pytest.raises(SceneError, match="at least 3 photos to find poses for, got 1"):
        load_scene(tmp_path / "few")


def test_without_colmap(photos: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(structure.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(DependencyError, match=r"pip install 'pcore-edit\[colmap\]'"):
        load_scene(photos)


def test_masks_beside_photos_without_poses_are_used(
    photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake(monkeypatch)
    photos.rename(tmp_path / "images")
    capture = tmp_path / "capture"
    capture.mkdir()
    (tmp_path / "images").rename(capture / "images")
    write_photos(capture / "masks", [f"IMG_{i}.png" for i in range(10)], mode="L")
    scene = load_scene(capture)
    assert scene.name == "capture"
    assert scene.split("train")[0].has_alpha


def video(path: Path, frames: int) -> Path:
    av = pytest.importorskip("av")
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 24, 16, "yuv420p"
        for index in range(frames):
            pixels = np.full((16, 24, 3), 10 * index, dtype=np.uint8)
            pixels[::2, ::2] = 255
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        container.mux(stream.encode())
    return path


def test_videos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake(monkeypatch)
    folder = tmp_path / "clip"
    folder.mkdir()
    video(folder / "walk.mp4", 12)
    for given in (folder, folder / "walk.mp4"):
        scene = load_scene(given)
        assert sum(len(split) for split in scene.views.values()) == 12
    assert list(folder.iterdir()) == [folder / "walk.mp4"]


def test_portrait_videos_are_turned(tmp_path: Path) -> None:
    """As a phone writes them: wide frames, and a track that is turned by 90 degrees clockwise."""
    path = video(tmp_path / "walk.mp4", 4)
    content = bytearray(path.read_bytes())
    start = content.find(b"tkhd") + 44
    content[start : start + 36] = struct.pack(">9i", 0, 1 << 16, 0, -1 << 16, 0, 0, 0, 0, 1 << 30)
    path.write_bytes(content)
    choose_frames(path, tmp_path / "frames", print)
    with Image.open(tmp_path / "frames" / "0000.jpg") as frame:
        assert frame.size == (16, 24)
        # The last row of what is stored is the first column: bright pixels lie in even rows.
        pixels = np.asarray(frame.convert("L"), dtype=float)
    assert pixels[:, 15].mean() > 40 + pixels[:, 0].mean()


def test_videos_without_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake(monkeypatch)
    path = video(tmp_path / "short.mp4", 1)
    with pytest.raises(SceneError, match="expected at least 3 frames of one scene, got 1"):
        load_scene(path)
    av = pytest.importorskip("av")
    with av.open(str(tmp_path / "sound.mp4"), "w") as container:
        stream = container.add_stream("aac", rate=48000, layout="mono")
        silence = av.AudioFrame.from_ndarray(
            np.zeros((1, 1024), np.float32), format="fltp", layout="mono"
        )
        silence.sample_rate = 48000
        container.mux(stream.encode(silence))
        container.mux(stream.encode())
    with pytest.raises(SceneError, match="expected a video with frames"):
        load_scene(tmp_path / "sound.mp4")
    (tmp_path / "none.mp4").write_bytes(b"no video at all")
    with pytest.raises(SceneError, match="cannot be decoded"):
        load_scene(tmp_path / "none.mp4")


def write_frames(path: Path, frames: list[np.ndarray]) -> Path:
    av = pytest.importorskip("av")
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for pixels in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        container.mux(stream.encode())
    return path


def pan(seed: int, count: int, speed: int = 1) -> list[np.ndarray]:
    """Frames (32, 48, 3) of a camera that moves along a wall of random patches."""
    wall = np.random.default_rng(seed).integers(0, 255, (4, 40, 3), dtype=np.uint8)
    wide = wall.repeat(8, axis=0).repeat(8, axis=1)
    return [np.ascontiguousarray(wide[:, k * speed : k * speed + 48]) for k in range(count)]


def test_of_two_scenes_the_longer_one_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake(monkeypatch)
    path = write_frames(tmp_path / "two.mp4", [*pan(0, 12), *pan(1, 30)])
    heard: list[str] = []
    scene = load_scene(path, tell=heard.append)
    said = "two.mp4 shows 2 scenes, with a cut between them: the longest one is used, frames 12 to"
    assert heard[0].startswith(said)
    assert sum(len(split) for split in scene.views.values()) == 30
    # What is kept of it says so, too.
    assert any(said in note for note in load_scene(path).notes)
    path = write_frames(tmp_path / "slides.mp4", [pan(k, 2)[1] for k in range(4) for _ in "ab"])
    with pytest.raises(SceneError, match=r"got 2 in the longest of 4 scenes"):
        load_scene(path)


def test_fast_pans_and_flashes_are_no_cuts() -> None:
    fast = pan(0, 30, speed=9)
    assert scenes_of(fast) == [(0, 30)]
    slow = pan(0, 30)
    slow[14] = np.full_like(slow[14], 255)
    assert scenes_of(slow) == [(0, 30)]
    assert scenes_of([*slow, *pan(1, 20), *pan(2, 10)]) == [(0, 30), (30, 50), (50, 60)]


@pytest.mark.slow
def test_twenty_real_photos(tmp_path: Path, shared_data: Path) -> None:
    beer = shared_data / "captures" / "beer" / "images"
    if structure.importlib.util.find_spec("pycolmap") is None or not beer.is_dir():
        pytest.skip("needs pycolmap and the capture 'beer'")
    from PIL import Image

    for path in sorted(beer.iterdir())[:60:3]:
        (tmp_path / "can").mkdir(exist_ok=True)
        with Image.open(path) as photo:
            photo.resize((360, 640)).save(tmp_path / "can" / path.name)
    heard: list[str] = []
    scene = load_scene(tmp_path / "can", tell=heard.append)
    assert sum(len(split) for split in scene.views.values()) >= 14, json.dumps(heard)
    assert scene.sparse is not None
    assert scene.sparse.errors is not None
    assert float(scene.sparse.errors.mean()) < 1.0


def test_photos_in_sub_folders_keep_their_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake(monkeypatch)
    rig = tmp_path / "rig"
    names = [f"cam{camera}/{i}.jpg" for camera in (10, 2) for i in range(5)]
    write_photos(rig, [*names, "masks/0.png"])
    scene = load_scene(rig)
    found = {view.name for views in scene.views.values() for view in views}
    assert found == {f"cam{camera}_{i}" for camera in (2, 10) for i in range(5)}
    assert scene.split("train")[0].name.startswith("cam2_")


def test_a_photo_that_was_saved_twice_is_used_once(
    photos: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake(monkeypatch)
    write_photos(photos, ["IMG_3.png"])
    scene = load_scene(photos)
    assert sum(len(split) for split in scene.views.values()) == 10
    assert [(one.name, one.reason) for one in scene.skipped] == [
        ("IMG_3.png", "no pose in the model; IMG_3.jpg of the same name has one")
    ]


def test_a_rendered_scene_without_its_file_is_no_folder_of_photos(tmp_path: Path) -> None:
    write_photos(tmp_path, ["train/r_0.png", "test/r_0.png"])
    with pytest.raises(SceneError, match="unknown format"):
        load_scene(tmp_path)


def test_photos_of_one_size_and_device_share_a_lens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = tmp_path / "asked.json"
    child(monkeypatch, f"import sys\nopen({str(asked)!r}, 'w').write(sys.argv[1])")
    folder = tmp_path / "walk"
    write_photos(folder, ["plain0.jpg", "plain1.png"])
    write_photos(folder, ["tall.jpg"], size=(16, 24))
    for index, (maker, focal) in enumerate([("a", 4.2), ("b", 4.2), ("a", 4.2), ("a", 9.0)]):
        exif = Image.Exif()
        exif[ExifTags.Base.Make] = maker
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLength] = focal
        Image.new("RGB", (24, 16)).save(folder / f"phone{index}.jpg", exif=exif)
        if index == 1:  # PNG files say it, too, and are not decoded for it.
            Image.new("RGB", (24, 16)).save(folder / "tablet.png", exif=exif)
    Image.new("RGB", (24, 16)).save(folder / "torn.jpg", exif=b"Exif\0\0II*\0\xff\xff")
    monkeypatch.setattr(PngImagePlugin.PngImageFile, "load", lambda self: pytest.fail("decoded"))
    with pytest.raises(SceneError, match="no common structure in 9 photos"):
        load_scene(folder)
    assert json.loads(asked.read_text())["cameras"] == [
        ["phone0.jpg", "phone2.jpg"],
        ["phone1.jpg", "tablet.png"],
        ["phone3.jpg"],
        ["plain0.jpg", "plain1.png", "torn.jpg"],
        ["tall.jpg"],
    ]


def test_photos_that_colmap_does_not_read_are_handed_to_it_as_png(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake(monkeypatch)
    folder = tmp_path / "web"
    write_photos(folder, [*(f"a{i}.webp" for i in range(5)), *(f"b{i}.jpg" for i in range(5))])
    (folder / "b4.jpg").write_text("<!DOCTYPE html>")
    before = sorted(folder.rglob("*"))
    scene = load_scene(folder)
    files = {view.image.path.name for views in scene.views.values() for view in views}
    assert files == {*(f"a{i}.webp" for i in range(5)), *(f"b{i}.jpg" for i in range(4))}
    assert [one.name for one in scene.skipped] == ["b4.jpg"]
    assert "a file of another kind" in scene.skipped[0].reason
    assert sorted(folder.rglob("*")) == before
    assert not list((tmp_path / "cache").rglob("*.png"))


@pytest.mark.parametrize("link", ["IMG_3.jpg", "walk"])
def test_links_that_lead_out_are_not_handed_to_colmap(
    link: str, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    child(monkeypatch, "raise SystemExit('COLMAP read them')")
    if link == "walk":
        photos = photos.rename(tmp_path / "elsewhere")
        (tmp_path / "scene").mkdir()
        (tmp_path / "scene" / link).symlink_to(photos)
        photos = tmp_path / "scene"
    else:
        (photos / link).rename(tmp_path / "secret.jpg")
        (photos / link).symlink_to(tmp_path / "secret.jpg")
    with pytest.raises(SceneError, match="leads out of the scene's folder"):
        load_scene(photos)


def test_portraits_are_handed_to_colmap_upright(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Phones store them lying down, with a tag: their cameras would lie down as well."""
    asked = tmp_path / "asked.json"
    look = (
        "import json, sys\nfrom pathlib import Path\nfrom PIL import Image\n"
        "wish = json.loads(sys.argv[1])\n"
        "sizes = {one.name: Image.open(one).size for one in Path(wish['images']).iterdir()}\n"
        "corner = Image.open(Path(wish['images']) / 'tall0.jpg').getpixel((2, 2))\n"
        f"Path({str(asked)!r}).write_text(json.dumps([wish['cameras'], sizes, corner]))\n"
    )
    child(monkeypatch, look)
    folder = tmp_path / "walk"
    folder.mkdir()
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    stored = Image.new("RGB", (24, 16))
    stored.paste((255, 255, 255), (0, 8, 8, 16))  # Below on the left, above on the left upright.
    for index in range(2):
        stored.save(folder / f"tall{index}.jpg", exif=exif, quality=100)
        stored.save(folder / f"wide{index}.jpg")
    Image.new("RGB", (16, 16)).save(folder / "square.jpg", exif=exif)
    with pytest.raises(SceneError, match="no common structure in 5 photos"):
        load_scene(folder)
    cameras, sizes, corner = json.loads(asked.read_text())
    assert sizes == {
        **{"tall0.jpg": [16, 24], "tall1.jpg": [16, 24], "square.jpg": [16, 16]},
        **{"wide0.jpg": [24, 16], "wide1.jpg": [24, 16]},
    }
    assert min(corner) > 200
    assert sorted(cameras) == [
        ["square.jpg"],
        ["tall0.jpg", "tall1.jpg"],
        ["wide0.jpg", "wide1.jpg"],
    ]


def test_a_portrait_with_damaged_exif_is_handed_on_without(tmp_path: Path) -> None:
    image = Image.new("RGB", (20, 12), "red")
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    image.save(tmp_path / "IMG_0.webp", exif=exif.tobytes()[:6] + b"garbage")
    copies, names = structure._readable(tmp_path, [tmp_path / "IMG_0.webp"], tmp_path / "copies")
    (name,) = names.values()
    with Image.open(copies / name) as copy:
        assert copy.size == (20, 12)
