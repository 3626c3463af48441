"""Masks by a short training: the ball of a room, also in photos that nothing was learned of."""

import pytest
import torch

from pcore.capture.load import load_scene
from pcore.errors import InputError
from pcore.training import trained_masks as module
from pcore.training.trainable_gaussians import TrainedGaussians
from pcore.training.trained_masks import trained_masks
from room_scene import WIDTH, picture, write_room


@pytest.mark.slow
def test_the_ball_of_a_room(tmp_path) -> None:
    scene = load_scene(write_room(tmp_path / "room", 24))
    told: list[tuple[int, int]] = []
    views, found = trained_masks(scene, steps=400, progress=lambda *done: told.append(done))
    assert [view.name for view in views[-3:]] == [view.name for view in scene.split("test")]
    overlaps = []
    for view, mask in zip(views, found.masks, strict=True):
        one, other = mask > 127, picture(view.camera)[1] > 0.5
        overlaps.append(float((one & other).sum() / (one | other).sum()))
    assert sum(overlaps) / len(overlaps) > 0.7
    assert told[-1] == (400, 400)


def test_a_room_without_anything_is_refused(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene(write_room(tmp_path / "room", 9))
    heard = []

    def nothing(scene, config, **_) -> TrainedGaussians:
        heard.append(config)
        return TrainedGaussians(gaussians=None, footprint=None, background=(1, 1, 1), step=1)

    monkeypatch.setattr(module, "fit_gaussians", nothing)
    monkeypatch.setattr(module, "find_shape", lambda *_: None)
    with pytest.raises(InputError, match="--masks FOLDER"):
        trained_masks(scene)
    assert heard[0].levels is None  # Photos this small are learned whole.


def test_large_photos_are_learned_small(tmp_path) -> None:
    camera = load_scene(write_room(tmp_path / "room", 9)).split("train")[0].camera
    config = module._config(camera.resized(20 * WIDTH, 960), 100)
    assert config.levels is not None
    assert config.levels[0].reduction == 8
    assert config.density.limit == 8 * module._config(camera, 100).density.limit
    assert torch.is_tensor(camera.center)
