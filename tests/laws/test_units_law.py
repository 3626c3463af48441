"""The law of units: metres or millimetres, here or there, a scene trains to the same object."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from pcore.asset.saving import asset_of, load
from pcore.capture.load import load_scene
from pcore.data.scene import Scene, View
from pcore.geometry.camera import Camera
from pcore.training import loop
from pcore.training.events import StepReport
from pcore.training.finetune import finetune
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.gaussian_fit import fit_gaussians
from pcore.training.presets import TINY
from pcore.training.pretrain import pretrain
from pcore.training.trained import Trained
from small_training import Heard, finetune_config, pretrain_config
from tiny_scene import write_scene

MODEL = replace(
    TINY.model,
    neighbours=4,
    feature_size=16,
    key=replace(TINY.model.key, width=16, size=16),
    query=replace(TINY.model.query, width=16, size=16),
    value=replace(TINY.model.value, width=16, size=8),
    unet_channels=(4, 6, 8),
)
SCALES = (1e-3, 0.1, 10.0, 1e3)
SHIFT = 5.0
"""About three of the object's sizes; single precision leaves 1e-6 of the scene there."""
FAR = 2000.0
"""About a thousand sizes, beyond what single precision can learn in."""
BAR = 1e-3


@dataclass(frozen=True, kw_only=True)
class Learned:
    """What came of the box in one unit.

    Attributes:
        losses: of every step of all three trainings, in order.
        model: pre-trained.
        means: (N, 3) of the Gaussians.
        rgb: (H, W, 3) of the camera, by the asset.
        depth: (H, W).
    """

    losses: Sequence[float]
    model: Trained
    means: Tensor
    rgb: Tensor
    depth: Tensor


@pytest.fixture(scope="module")
def box(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """The painted box, two units wide, seen from a distance of 4."""
    root = tmp_path_factory.mktemp("units") / "box"
    return load_scene(write_scene(root, meshes=False, states=False))


@pytest.fixture(scope="module")
def usual(box: Scene) -> Learned:
    """The box as it is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "_REPORT_EVERY", 1)
        return learn(box)


def brought(camera: Camera, scale: float, shift: float) -> Camera:
    """The camera in a world where places are `scale` x + `shift`."""
    pose = camera.world_from_camera.double().clone()
    pose[:3, 3] = scale * pose[:3, 3] + shift
    return camera.moved(pose.float())


def in_units(scene: Scene, scale: float, shift: float = 0.0) -> Scene:
    """The same photos in another world."""

    def change(view: View) -> View:
        return replace(view, camera=brought(view.camera, scale, shift))

    return replace(scene, views={"train": tuple(change(view) for view in scene.split("train"))})


def learn(scene: Scene, camera: Camera | None = None) -> Learned:
    """Pre-train, fine-tune and fit Gaussians for a few steps, and draw a picture."""
    heard = Heard()
    config = pretrain_config(
        model=MODEL, origin="reference", points=300, front_weight=0.3, opacity_weight=0.1
    )
    model = pretrain(scene, config, listener=heard)
    tuned = finetune(scene, model, finetune_config(front_weight=0.3), listener=heard)
    gaussians = fit_gaussians(scene, GaussianConfig(steps=8, points=60), listener=heard)
    asset = asset_of(tuned.papr.eval(), tuned.cloud, surfels=tuned.surfels)
    image = asset.render(None, camera or scene.split("train")[0].camera)
    return Learned(
        losses=[event.loss for event in heard.of(StepReport)],
        model=model,
        means=gaussians.gaussians.means,
        rgb=image.rgb,
        depth=image.depth,
    )


def check_same(
    found: Learned, usual: Learned, scale: float, shift: float, *, deep: float = 5 * BAR
) -> None:
    """Losses within the bar, places that go along, the same picture, and depth within `deep`."""
    assert len(found.losses) == len(usual.losses) == 12 + 6 + 8
    off = sorted(
        abs(one / other - 1) for one, other in zip(found.losses, usual.losses, strict=True)
    )
    # Two points may be equally near to a ray, and rounding then chooses: of 24 steps (4 seeds) one
    # was off by 4e-3, the others by 2e-4 at most.
    assert off[-2] < BAR
    assert off[-1] < 10 * BAR
    positions, surfels = found.model.cloud.positions, found.model.surfels
    assert surfels is not None
    assert usual.model.surfels is not None
    assert torch.allclose(
        (positions - shift) / scale, usual.model.cloud.positions, rtol=0, atol=BAR
    )
    assert torch.allclose(surfels.heights / scale, usual.model.surfels.heights, rtol=0, atol=BAR)
    assert torch.allclose((found.means - shift) / scale, usual.means, rtol=0, atol=BAR)
    # Here, too, one pixel of 576 may see the other of two points that are equally near.
    colors = (found.rgb - usual.rgb).abs().amax(dim=-1).flatten().sort().values
    assert float(colors.mean()) < BAR / 10
    assert float(colors[-2]) < 5 * BAR
    assert float(colors[-1]) < 10 * BAR
    assert torch.equal(found.depth.isnan(), usual.depth.isnan())
    depths = (found.depth / scale - usual.depth).abs().nan_to_num().flatten().sort().values
    assert float(depths[-2]) < deep


@pytest.mark.parametrize("scale", SCALES)
def test_scale(box: Scene, usual: Learned, scale: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop, "_REPORT_EVERY", 1)
    check_same(learn(in_units(box, scale)), usual, scale, 0.0)


def test_shift(box: Scene, usual: Learned, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop, "_REPORT_EVERY", 1)
    check_same(learn(in_units(box, 1.0, SHIFT)), usual, 1.0, SHIFT)


def test_shift_far_away(
    box: Scene, usual: Learned, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = write_scene(tmp_path / "box", meshes=False, states=False)
    for path in root.glob("transforms_*.json"):
        content = json.loads(path.read_text())
        for frame in content["frames"]:
            for row in frame["transform_matrix"][:3]:
                row[3] += FAR
        path.write_text(json.dumps(content))
    monkeypatch.setattr(loop, "_REPORT_EVERY", 1)
    # Trained near the origin; what it hands over is in float32, in steps of 1.2e-4 there, and the
    # depth of a surface that is seen at a slant moves by a hundred of them.
    check_same(learn(load_scene(root)), usual, 1.0, FAR, deep=100 * 1.2e-4)


def test_the_frame_is_kept_in_the_model_file(box: Scene, tmp_path: Path) -> None:
    model = pretrain(in_units(box, 10.0, SHIFT), pretrain_config(steps=1))
    frame = model.papr.config.frame
    assert frame is not None
    assert frame.center == pytest.approx((SHIFT, SHIFT, SHIFT), abs=1e-4)
    assert frame.unit == pytest.approx(10 * box.radius / 1.3654, rel=1e-4)
    asset = asset_of(model.papr.eval(), model.cloud)
    camera = brought(box.split("train")[1].camera, 10.0, SHIFT)
    read = load(asset.save(tmp_path / "run").path)
    assert torch.equal(read.render(None, camera).rgb, asset.render(None, camera).rgb)
