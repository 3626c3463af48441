from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from pcore.capture.load import load_scene
from pcore.data.images import composite
from pcore.data.scene import Scene, hold_out
from pcore.errors import InputError, SceneError
from scene_files import change_frame, pose, write_split


def test_view_shapes_and_compositing(scene: Path) -> None:
    view = load_scene(scene).split("train")[1]
    assert view.name == "r_1"
    assert view.has_alpha
    assert view.rgba().shape == (8, 12, 4)
    background = torch.tensor([0.1, 0.5, 0.9])
    assert torch.equal(view.rgb(background), composite(view.rgba(), background))
    assert torch.equal(view.alpha(), view.rgba()[..., 3])


def test_writing_to_an_image_does_not_change_the_scene(scene: Path) -> None:
    view = load_scene(scene).split("train")[0]
    before = view.rgba()
    view.rgba().zero_()
    view.alpha().zero_()
    assert torch.equal(view.rgba(), before)


def test_memory_budget_is_shared_by_all_views(scene: Path) -> None:
    one = 8 * 12 * 4 * 4
    loaded = load_scene(scene, memory_budget=2 * one)
    views = [*loaded.split("train"), *loaded.split("test")]
    for view in views:
        view.rgba()
    cache = views[0].image.cache
    assert all(view.image.cache is cache for view in views)
    assert cache.bytes_used == 2 * one


def test_images_are_decoded_lazily(scene: Path) -> None:
    loaded = load_scene(scene)
    assert loaded.split("train")[0].image.cache.bytes_used == 0


def test_bounds_are_the_sphere_that_all_training_views_see(scene: Path) -> None:
    loaded = load_scene(scene)
    assert torch.allclose(loaded.center, torch.zeros(3), atol=1e-6)
    # 12 x 8 pixels: the vertical field of view is the narrower one.
    half = np.arctan(np.tan(0.35) * 8 / 12)
    assert loaded.radius == pytest.approx(4.0 * np.sin(half), abs=1e-5)
    assert torch.allclose(loaded.upper, torch.full((3,), loaded.radius), atol=1e-5)
    assert torch.equal(loaded.upper - loaded.center, loaded.center - loaded.lower)


def test_bounds_follow_the_cameras(scene: Path) -> None:
    offset = torch.tensor([1.0, -2.0, 0.5])
    loaded = load_scene(scene)
    moved = []
    for view in loaded.split("train"):
        matrix = view.camera.world_from_camera.clone()
        matrix[:3, 3] += offset
        moved.append(replace(view, camera=view.camera.moved(matrix)))
    shifted = replace(loaded, views={"train": tuple(moved)})
    assert torch.allclose(shifted.lower, loaded.lower + offset, atol=1e-5)
    assert torch.allclose(shifted.upper, loaded.upper + offset, atol=1e-5)


def test_bounds_ignore_test_views(scene: Path) -> None:
    before = load_scene(scene)
    for index in range(2):
        change_frame(scene / "transforms_test.json", index, transform_matrix=pose(1.0, radius=9.0))
    after = load_scene(scene)
    assert torch.equal(before.lower, after.lower)
    assert before.radius == after.radius


def test_parallel_views_have_no_bounds(tmp_path: Path) -> None:
    write_split(tmp_path, "train", count=1)
    with pytest.raises(SceneError, match=r"axes of its 1 view\(s\) are parallel"):
        _ = load_scene(tmp_path).lower


def test_views_that_look_away_have_no_bounds(scene: Path) -> None:
    for index in range(3):
        matrix = np.array(pose(2.0 * index, 0.4 - 0.3 * index))
        matrix[:3, [0, 2]] *= -1  # turned around: OpenCV axes would do this
        change_frame(scene / "transforms_train.json", index, transform_matrix=matrix.tolist())
    with pytest.raises(SceneError, match=r"no view sees the point .* OpenGL axes"):
        _ = load_scene(scene).upper


def test_unknown_split(scene: Path) -> None:
    loaded = load_scene(scene)
    assert loaded.splits == ("train", "test")
    with pytest.raises(SceneError, match="no split 'val'; it has train, test"):
        loaded.split("val")


def test_hold_out_is_a_deterministic_partition(tmp_path: Path) -> None:
    write_split(tmp_path, "train", count=10)
    loaded: Scene = load_scene(tmp_path)
    views = loaded.split("train")
    fit, held = hold_out(views, every=4)
    assert [v.name for v in held] == ["r_2", "r_6"]
    assert [v.name for v in fit] == ["r_0", "r_1", "r_3", "r_4", "r_5", "r_7", "r_8", "r_9"]
    assert hold_out(views, every=4) == (fit, held)
    with pytest.raises(InputError, match="every: expected a whole number of at least 2, got 1"):
        hold_out(views, every=1)
