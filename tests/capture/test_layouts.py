"""Every layout gives the same cameras, whatever its axes, matrices and pixel centres."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from capture_files import (
    HEIGHT,
    PLAIN,
    WIDTH,
    Shot,
    points,
    shots,
    write_camera_list,
    write_colmap,
    write_idr,
    write_llff,
    write_model,
    write_ngp,
    write_nsvf,
    write_photos,
    write_transforms,
)
from pcore.capture.layouts import layout_of
from pcore.capture.load import load_scene
from pcore.data.scene import Scene, View
from pcore.errors import SceneError
from scene_files import write_split

WRITERS: dict[str, Callable[[Path], list[Shot]]] = {
    "COLMAP": write_colmap,
    "transforms.json": write_ngp,
    "IDR / NeuS": write_idr,
    "LLFF": write_llff,
    "NSVF / Tanks and Temples": write_nsvf,
    "3DGS cameras.json": write_camera_list,
}


def views_of(scene: Scene) -> dict[str, View]:
    return {view.name: view for split in scene.views.values() for view in split}


@pytest.mark.parametrize("layout", WRITERS)
def test_cameras(layout: str, tmp_path: Path) -> None:
    photos = WRITERS[layout](tmp_path)
    scene = load_scene(tmp_path)
    assert scene.layout == layout
    views = views_of(scene)
    assert len(views) == len(photos)
    for shot in photos:
        camera = views[Path(shot.name).stem].camera
        assert (camera.width, camera.height) == (WIDTH, HEIGHT)
        np.testing.assert_allclose(camera.world_from_camera, shot.matrix, atol=2e-5)
        fy = 29.0 if layout == "IDR / NeuS" else 30.0
        numbers = (camera.fx, camera.fy, camera.cx, camera.cy)
        np.testing.assert_allclose(numbers, (30.0, fy, 12.0, 8.0), atol=1e-3)


@pytest.mark.parametrize("layout", WRITERS)
def test_nothing_is_written(layout: str, tmp_path: Path) -> None:
    WRITERS[layout](tmp_path)
    before = {path: path.stat().st_mtime_ns for path in sorted(tmp_path.rglob("*"))}
    scene = load_scene(tmp_path, factor=2)
    scene.split("train")[0].rgba()
    assert {path: path.stat().st_mtime_ns for path in sorted(tmp_path.rglob("*"))} == before


def test_every_eighth_view_in_natural_order_is_held_out(tmp_path: Path) -> None:
    write_ngp(tmp_path, count=18)
    scene = load_scene(tmp_path)
    assert [view.name for view in scene.split("test")] == ["img_0", "img_8", "img_16"]
    assert [view.name for view in scene.split("train")][6:9] == ["img_7", "img_9", "img_10"]


def test_splits_of_the_format(tmp_path: Path) -> None:
    write_nsvf(tmp_path)
    scene = load_scene(tmp_path)
    assert {name: len(views) for name, views in scene.views.items()} == {
        "train": 3,
        "val": 1,
        "test": 2,
    }
    assert scene.region is not None
    assert scene.region.box is not None
    assert scene.region.box.tolist() == [[-1, -2, -3], [1, 2, 3]]


def test_regions(tmp_path: Path) -> None:
    write_idr(tmp_path / "idr")
    region = load_scene(tmp_path / "idr").region
    assert region is not None
    assert region.radius == pytest.approx(2.0)
    torch.testing.assert_close(region.center, torch.tensor([0.1, 0.2, 0.3]))
    write_ngp(tmp_path / "ngp", aabb=[[-1, -1, 0], [1, 1, 2]])
    region = load_scene(tmp_path / "ngp").region
    assert region is not None
    assert region.center.tolist() == [0, 0, 1]
    # 0.5 in instant-ngp's own world is the origin; its x is the file's y.
    inside = [[0.17, 0.5, 0.5], [0.83, 0.83, 0.83]]
    write_ngp(tmp_path / "own", render_aabb=inside)
    region = load_scene(tmp_path / "own").region
    assert region is not None
    assert region.box is not None
    torch.testing.assert_close(region.box, torch.tensor([[0.0, -1, 0], [1, 1, 1]]))
    for name, offset in (("one", 0.5), ("three", [0.5, 0.4, 0.3])):
        corners = [[0.3, 0.3, 0.3], [0.7, 0.7, 0.7]]
        write_ngp(tmp_path / name, render_aabb=corners, scale=1, offset=offset)
        region = load_scene(tmp_path / name).region
        assert region is not None
        assert region.box is not None
        torch.testing.assert_close(region.box, torch.tensor(corners) - torch.tensor(offset))


@pytest.mark.parametrize("text", [False, True])
def test_lenses_of_cameras_without_images_do_not_count(tmp_path: Path, text: bool) -> None:
    unread = {
        3: ("OPENCV_FISHEYE", WIDTH, HEIGHT, [30.0, 30.0, 12.0, 8.0, *[0.1] * 4]),
        4: ("THIN_PRISM_FISHEYE", WIDTH, HEIGHT, [30.0, 30.0, 12.0, 8.0, *[0.1] * 8]),
    }
    write_colmap(tmp_path, cameras={**unread, 1: PLAIN}, text=text)
    assert load_scene(tmp_path).split("train")[0].camera.focal == (30, 30)


def test_masks_of_instant_ngp(tmp_path: Path) -> None:
    photos = write_ngp(tmp_path)
    write_photos(
        tmp_path / "images", [f"dynamic_mask_{shot.name}" for shot in photos[1:]], mode="L"
    )
    scene = load_scene(tmp_path)
    assert not scene.split("train")[0].has_alpha
    assert any("what moves" in note and "for 9 photos and not used" in note for note in scene.notes)
    write_photos(tmp_path / "images", [f"{shot.name}.alpha.png" for shot in photos], mode="L")
    assert load_scene(tmp_path).split("train")[0].has_alpha


@pytest.mark.parametrize(("key", "grey"), [("white_transparent", 255), ("black_transparent", 0)])
def test_colours_that_instant_ngp_takes_for_background(tmp_path: Path, key: str, grey: int) -> None:
    photos = write_ngp(tmp_path, **{key: True})
    pixels = np.full((HEIGHT, WIDTH, 3), 255 - grey, np.uint8)
    pixels[:4] = grey
    pixels[4, :, 1:] = grey  # One channel is another: object.
    for shot in photos:
        Image.fromarray(pixels).save(tmp_path / "images" / shot.name)
    view = load_scene(tmp_path).split("train")[0]
    assert view.has_alpha
    assert view.alpha()[:4].max() == 0
    assert view.alpha()[4:].min() == 1
    assert not load_scene(tmp_path, masks="none").split("train")[0].has_alpha
    write_ngp(tmp_path, **{key: "yes"})
    with pytest.raises(SceneError, match=f"expected true or false in '{key}', got 'yes'"):
        load_scene(tmp_path)


def test_masks_beside_photos_of_two_cameras(tmp_path: Path) -> None:
    photos = shots(10)
    for number, shot in enumerate(photos):
        shot.name = f"cam{number % 2}/{number // 2}.png"
    write_photos(tmp_path / "images", [shot.name for shot in photos])
    write_model(tmp_path / "sparse" / "0", photos)
    write_photos(tmp_path / "masks", [f"{number}.png" for number in range(5)], mode="L")
    scene = load_scene(tmp_path)
    assert not scene.split("train")[0].has_alpha
    assert any("10 photos share theirs" in note for note in scene.notes)
    write_photos(tmp_path / "masks", [shot.name for shot in photos], mode="L")
    scene = load_scene(tmp_path)
    masks = {view.name: view.image.mask for view in scene.split("train")}
    assert {mask.parent.name for mask in masks.values() if mask} == {"cam0", "cam1"}


def test_masks_of_idr_are_paired_by_order(tmp_path: Path) -> None:
    write_idr(tmp_path)
    scene = load_scene(tmp_path)
    assert scene.split("train")[0].has_alpha
    assert any("000.png is that of 000000.png" in note for note in scene.notes)


@pytest.mark.parametrize("ending", [".png", ".jpg"])
def test_masks_beside_photos(tmp_path: Path, ending: str) -> None:
    photos = write_colmap(tmp_path)
    write_photos(tmp_path / "masks", [f"{shot.name}{ending}" for shot in photos], mode="L")
    assert load_scene(tmp_path).split("train")[0].has_alpha
    (tmp_path / "masks" / f"{photos[0].name}{ending}").unlink()
    scene = load_scene(tmp_path)
    assert not scene.split("train")[0].has_alpha
    assert any("are there for 9 of 10 photos" in note for note in scene.notes)


class TestTransforms:
    """What tools and users write into `transforms.json`."""

    def test_missing_images_are_listed(self, tmp_path: Path) -> None:
        write_ngp(tmp_path)
        (tmp_path / "images" / "img_3.png").unlink()
        scene = load_scene(tmp_path)
        assert [one.name for one in scene.skipped] == ["images/img_3.png"]
        assert any("1 of 10 photos are not used: images/img_3.png" in note for note in scene.notes)

    def test_paths_of_other_machines(self, tmp_path: Path) -> None:
        photos = shots(4)
        write_photos(tmp_path / "images", [shot.name.replace(".png", ".JPG") for shot in photos])
        write_transforms(tmp_path, photos)
        content = json.loads((tmp_path / "transforms.json").read_text())
        paths = ["/home/me/cap/images/img_0.jpg", r"C:\cap\images\img_1.jpg", r"images\img_2.jpg"]
        for frame, path in zip(content["frames"], paths, strict=False):
            frame["file_path"] = path
        (tmp_path / "transforms.json").write_text(json.dumps(content))
        scene = load_scene(tmp_path)
        assert not scene.skipped
        assert set(views_of(scene)) == {"img_0", "img_1", "img_2", "img_3"}

    def test_sizes_and_lenses_of_frames(self, tmp_path: Path) -> None:
        photos = shots(4)
        write_photos(tmp_path / "images", [shot.name for shot in photos[:2]])
        write_photos(tmp_path / "images", [shot.name for shot in photos[2:]], size=(16, 24))
        own = [
            {"w": w, "h": h, "fl_x": 20.0 + w, "fl_y": 20.0, "cx": w / 2, "cy": h / 2}
            for w, h in [(24, 16), (24, 16), (16, 24), (32, 48)]
        ]
        write_transforms(tmp_path, photos, fl_x=None, fl_y=None, cx=None, cy=None, w=None, h=None)
        content = json.loads((tmp_path / "transforms.json").read_text())
        for frame, keys in zip(content["frames"], own, strict=True):
            frame.update(keys)
        (tmp_path / "transforms.json").write_text(json.dumps(content))
        views = views_of(load_scene(tmp_path))
        camera = views["img_3"].camera
        assert (camera.width, camera.height, camera.fx, camera.cx) == (16, 24, 26.0, 8.0)
        assert views["img_0"].camera.width == 24

    def test_numbers_as_text_and_three_rows(self, tmp_path: Path) -> None:
        photos = write_ngp(tmp_path, k1="0.0", k2="0.1")
        content = json.loads((tmp_path / "transforms.json").read_text())
        for frame in content["frames"]:
            frame["transform_matrix"] = frame["transform_matrix"][:3]
        (tmp_path / "transforms.json").write_text(json.dumps(content))
        view = views_of(load_scene(tmp_path))["img_1"]
        np.testing.assert_allclose(view.camera.world_from_camera, photos[1].matrix, atol=1e-6)
        assert view.image.lens is not None
        assert view.image.lens.k2 == 0.1

    def test_named_splits(self, tmp_path: Path) -> None:
        names = [f"./images/img_{i}.png" for i in range(6)]
        write_ngp(tmp_path, count=6, train_filenames=names[:4], test_filenames=names[4:])
        scene = load_scene(tmp_path)
        assert [view.name for view in scene.split("test")] == ["img_4", "img_5"]

    def test_points(self, tmp_path: Path) -> None:
        write_ngp(tmp_path, ply_file_path="sparse_pc.ply", applied_transform=np.eye(4)[:3].tolist())
        header = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        header += (
            "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
        )
        (tmp_path / "sparse_pc.ply").write_text(f"{header}end_header\n1 2 3 255 0 0\n")
        sparse = load_scene(tmp_path).sparse
        assert sparse is not None
        assert sparse.positions.tolist() == [[1, 2, 3]]
        assert sparse.colors is not None
        assert sparse.colors.tolist() == [[1, 0, 0]]

    def test_rotations_that_are_off_a_little(self, tmp_path: Path) -> None:
        photos = shots()
        exact = photos[0].matrix.copy()
        photos[0].matrix[:3, :3] *= 1.005
        write_photos(tmp_path / "images", [shot.name for shot in photos])
        write_transforms(tmp_path, photos)
        scene = load_scene(tmp_path)
        camera = views_of(scene)["img_0"].camera
        np.testing.assert_allclose(camera.world_from_camera, exact, atol=1e-5)
        assert any("nearest rotation" in note for note in scene.notes)

    def test_smaller_photos_than_the_file_says(self, tmp_path: Path) -> None:
        write_ngp(tmp_path, w=96, h=64, fl_x=120, fl_y=120, cx=48, cy=32)
        camera = views_of(load_scene(tmp_path))["img_0"].camera
        assert (camera.fx, camera.cx, camera.cy) == (30.0, 12.0, 8.0)

    def test_copies_of_the_wished_size(self, tmp_path: Path) -> None:
        photos = write_ngp(tmp_path, w=48, h=32, fl_x=60, fl_y=60, cx=24, cy=16)
        write_photos(tmp_path / "images", [shot.name for shot in photos], size=(48, 32))
        write_photos(tmp_path / "images_2", [shot.name for shot in photos])
        view = views_of(load_scene(tmp_path, factor=2))["img_0"]
        assert view.image.path.parent.name == "images_2"
        assert (view.camera.width, view.camera.fx) == (24, 30.0)


class TestColmap:
    """Where models lie and what they hold."""

    @pytest.mark.parametrize("text", [False, True])
    def test_points_and_who_sees_them(self, text: bool, tmp_path: Path) -> None:
        write_colmap(tmp_path, text=text)
        scene = load_scene(tmp_path, factor=2)
        sparse = scene.sparse
        assert sparse is not None
        assert sparse.colors is not None
        assert sparse.errors is not None
        assert sparse.sightings is not None
        assert sparse.seen_by is not None
        np.testing.assert_allclose(sparse.positions, points(), atol=1e-6)
        torch.testing.assert_close(sparse.colors[0], torch.tensor([1.0, 0.0, 0.2]))
        assert sparse.errors.tolist() == [0.5] * 20
        assert sparse.seen_by.tolist() == [10] * 20
        for name, view in views_of(scene).items():
            rows, places = sparse.sightings.of(name)
            column, row, _ = view.camera.project(sparse.positions[rows])
            torch.testing.assert_close(torch.stack([column, row], 1), places, atol=1e-4, rtol=0)

    @pytest.mark.parametrize(
        ("model", "numbers"),
        [
            ("SIMPLE_RADIAL", [30.0, 12.5, 8.0, 0.1]),
            ("RADIAL", [30.0, 12.0, 7.5, -0.1, 0.05]),
            ("OPENCV", [31.0, 30.0, 12.0, 8.0, 0.05, -0.02, 0.004, -0.003]),
            ("PINHOLE", [31.0, 30.0, 11.0, 8.0]),
        ],
    )
    def test_lenses(self, model: str, numbers: list[float], tmp_path: Path) -> None:
        write_colmap(tmp_path, cameras={1: (model, WIDTH, HEIGHT, numbers)})
        scene = load_scene(tmp_path)
        assert scene.sparse is not None
        assert scene.sparse.sightings is not None
        for name, view in views_of(scene).items():
            assert (view.image.lens is None) == (model == "PINHOLE")
            rows, places = scene.sparse.sightings.of(name)
            column, row, _ = view.camera.project(scene.sparse.positions[rows])
            torch.testing.assert_close(torch.stack([column, row], 1), places, atol=1e-3, rtol=0)

    def test_the_largest_model(self, tmp_path: Path) -> None:
        photos = shots()
        write_photos(tmp_path / "images", [shot.name for shot in photos])
        write_model(tmp_path / "sparse" / "0", photos[:2])
        write_model(tmp_path / "sparse" / "1", photos)
        scene = load_scene(tmp_path)
        assert len(views_of(scene)) == 10
        assert any("sparse/1 is the largest model, with 10 images" in note for note in scene.notes)

    def test_points_of_photos_that_are_gone_are_as_good_as_before(self, tmp_path: Path) -> None:
        """They were found in ten photos, however many of these were copied along."""
        for shot in write_colmap(tmp_path)[2:]:
            (tmp_path / "images" / shot.name).unlink()
        sparse = load_scene(tmp_path).sparse
        assert sparse is not None
        assert sparse.seen_by is not None
        assert sparse.sightings is not None
        assert len(sparse.sightings.names) == 2
        assert sparse.seen_by.tolist() == [10] * 20

    def test_the_folder_of_models_chooses_the_largest_of_them(self, tmp_path: Path) -> None:
        photos = shots()
        write_photos(tmp_path / "images", [shot.name for shot in photos])
        write_model(tmp_path / "sparse" / "0", photos[:2])
        write_model(tmp_path / "sparse" / "1", photos)
        scene = load_scene(tmp_path / "sparse")
        assert (scene.layout, scene.root) == ("COLMAP", tmp_path)
        assert len(views_of(scene)) == 10
        assert any("1 is the largest model, with 10 images" in note for note in scene.notes)

    def test_photos_of_a_posed_capture_are_told_to_have_poses(self, tmp_path: Path) -> None:
        write_colmap(tmp_path)
        assert "sparse/0 for them" in layout_of(tmp_path / "images").note
        assert layout_of(tmp_path).note == ""

    @pytest.mark.parametrize("model", [".", "sparse/0"])
    def test_a_folder_of_captures_is_none(self, model: str, tmp_path: Path) -> None:
        """Neither the largest of them nor photos of all is what anybody meant."""
        for name, count in (("cup", 10), ("jug", 12)):
            photos = shots(count)
            write_model(tmp_path / name / model, photos)
            write_photos(tmp_path / name, [shot.name for shot in photos])
        with pytest.raises(SceneError, match=r"holds 2 captures.*one: .*/cup, .*/jug"):
            load_scene(tmp_path)
        assert len(views_of(load_scene(tmp_path / "jug"))) == 12

    @pytest.mark.parametrize("place", ["sparse", "colmap_sparse/0", "colmap/sparse/0", "."])
    def test_places(self, place: str, tmp_path: Path) -> None:
        photos = shots()
        write_photos(tmp_path / "images", [shot.name for shot in photos])
        write_model(tmp_path / place, photos)
        (tmp_path / place / "rigs.bin").write_bytes(b"\0" * 8)
        (tmp_path / place / "frames.bin").write_bytes(b"\0" * 8)
        assert len(views_of(load_scene(tmp_path))) == 10

    def test_a_distorted_model_goes_with_its_input(self, tmp_path: Path) -> None:
        photos = shots()
        write_photos(tmp_path / "input", [shot.name for shot in photos])
        write_photos(tmp_path / "images", [shot.name for shot in photos], size=(20, 12))
        write_model(tmp_path / "distorted" / "sparse" / "0", photos)
        view = views_of(load_scene(tmp_path))["img_0"]
        assert view.image.path.parent.name == "input"

    def test_cameras_and_sizes_of_each_photo_in_sub_folders(self, tmp_path: Path) -> None:
        photos = shots(4, "a/img_{}.png")
        photos[3].name, photos[3].camera = "b/img_0.png", 2
        write_photos(tmp_path / "images", [shot.name for shot in photos[:3]])
        write_photos(tmp_path / "images", ["b/img_0.png"], size=(16, 24))
        cameras = {
            1: ("SIMPLE_PINHOLE", WIDTH, HEIGHT, [30.0, 12.0, 8.0]),
            2: ("SIMPLE_PINHOLE", 16, 24, [33.0, 8.0, 12.0]),
        }
        write_model(tmp_path / "sparse" / "0", photos, cameras)
        views = views_of(load_scene(tmp_path))
        assert set(views) == {"a_img_0", "img_1", "img_2", "b_img_0"}
        assert (views["b_img_0"].camera.fx, views["b_img_0"].camera.height) == (33.0, 24)

    def test_sub_folders_that_were_dropped(self, tmp_path: Path) -> None:
        photos = shots(4, "a/img_{}.png")
        write_photos(tmp_path / "images", [Path(shot.name).name for shot in photos])
        write_model(tmp_path / "sparse" / "0", photos)
        assert len(views_of(load_scene(tmp_path))) == 4

    def test_rounded_copies(self, tmp_path: Path) -> None:
        """Mip-NeRF 360: a quarter of 1001 x 671 is 250 x 168, scaled otherwise along x than y."""
        photos = shots(4)
        write_photos(tmp_path / "images_4", [shot.name for shot in photos], size=(250, 168))
        camera = ("PINHOLE", 1001, 671, [800.0, 810.0, 500.5, 335.5])
        write_model(tmp_path / "sparse" / "0", photos, {1: camera})
        for factor in (1, 4):
            scene = load_scene(tmp_path, factor=factor)
            found = views_of(scene)["img_0"].camera
            assert (found.width, found.height) == (250, 168)
            assert (found.fx, found.cx) == pytest.approx((800 * 250 / 1001, 125.0))
            assert (found.fy, found.cy) == pytest.approx((810 * 168 / 671, 84.0))
            assert any("images_4" in note for note in scene.notes)

    def test_photos_that_the_model_does_not_pose_are_listed(self, tmp_path: Path) -> None:
        write_colmap(tmp_path)
        write_photos(tmp_path / "images", ["more.png"])
        scene = load_scene(tmp_path)
        assert [one.name for one in scene.skipped] == ["images/more.png"]
        assert any("1 of 11 photos are not used: images/more.png" in one for one in scene.notes)

    def test_lists_of_names_are_splits(self, tmp_path: Path) -> None:
        write_colmap(tmp_path)
        (tmp_path / "train_list.txt").write_text("img_1.png\nimg_2.png\nimg_4.png\n")
        (tmp_path / "test_list.txt").write_text("img_3.png\n")
        scene = load_scene(tmp_path)
        assert [view.name for view in scene.split("test")] == ["img_3"]
        assert len(scene.split("train")) == 3

    @pytest.mark.parametrize("orientation", [3, 6])
    def test_photos_are_taken_as_they_are_stored(self, orientation: int, tmp_path: Path) -> None:
        photos = write_colmap(tmp_path)
        exif = Image.Exif()
        exif[274] = orientation
        for shot in photos:
            path = tmp_path / "images" / shot.name
            Image.open(path).save(path, exif=exif)
        scene = load_scene(tmp_path)
        camera = views_of(scene)["img_0"].camera
        assert (camera.width, camera.height) == (WIDTH, HEIGHT)
        assert any("as they are stored" in note for note in scene.notes)

    def test_a_factor_that_leaves_a_rest_cuts_it_off(self, tmp_path: Path) -> None:
        write_colmap(tmp_path)
        view = views_of(load_scene(tmp_path, factor=5))["img_0"]
        assert (view.camera.width, view.camera.height) == (4, 3)
        assert (view.camera.fx, view.camera.cx) == (6.0, 2.4)
        assert view.rgba().shape == (3, 4, 4)


class TestChoice:
    """Folders that hold several layouts, or none."""

    def test_two_layouts_are_named(self, tmp_path: Path) -> None:
        write_colmap(tmp_path)
        write_transforms(tmp_path, shots())
        with pytest.raises(SceneError, match=r"2 layouts.*transforms\.json \(give .*COLMAP \(give"):
            load_scene(tmp_path)
        assert load_scene(tmp_path / "transforms.json").layout == "transforms.json"
        scene = load_scene(tmp_path / "sparse" / "0")
        assert scene.layout == "COLMAP"
        assert scene.root == tmp_path.resolve()

    def test_a_rendered_scene_beside_another(self, tmp_path: Path) -> None:
        write_split(tmp_path, "train")
        write_colmap(tmp_path)
        with pytest.raises(SceneError, match="NeRF-Synthetic"):
            load_scene(tmp_path)
        assert len(load_scene(tmp_path / "transforms_train.json").split("train")) == 3

    def test_what_another_was_made_of_is_no_second_one(self, tmp_path: Path) -> None:
        photos = write_ngp(tmp_path / "nerfstudio")
        write_model(tmp_path / "nerfstudio" / "colmap" / "sparse" / "0", photos)
        assert load_scene(tmp_path / "nerfstudio").layout == "transforms.json"
        write_llff(tmp_path / "llff")
        photos = shots(9, "IMG_{}.JPG")
        write_model(tmp_path / "llff" / "sparse" / "0", photos)
        assert load_scene(tmp_path / "llff").layout == "COLMAP"

    def test_cameras_json_of_other_programs(self, tmp_path: Path) -> None:
        write_colmap(tmp_path)
        (tmp_path / "cameras.json").write_text("[]")
        assert load_scene(tmp_path).layout == "COLMAP"
