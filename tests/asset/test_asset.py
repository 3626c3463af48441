"""The one door: what it accepts, refuses, saves and draws."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from tests.cli.toys import CONFIG, toy_cameras, toy_cloud
from tests.seeded_runs import RUNS, TWIST, write_edits, write_moving_edit, write_runs
from torch import Tensor

import pcore
from pcore.asset.neural_points import NeuralPoints
from pcore.asset.saving import asset_of
from pcore.asset.training import finetune_settings
from pcore.deform.simple import uniform_scale
from pcore.errors import CheckpointError, EditError, InputError
from pcore.files.model_file import MODEL_FILE
from pcore.files.skinning_file import SKINNING_FILE
from pcore.geometry.camera import Camera
from pcore.geometry.posed import PosedCloud
from pcore.model.papr import Papr
from pcore.relight.light_file import LIGHT_FILE

TWISTED: dict[str, Any] = {"version": 2, "edits": [TWIST]}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return write_runs(tmp_path_factory.mktemp("runs"))


@pytest.fixture
def camera() -> Camera:
    return toy_cameras(1, size=8)[0]


def test_everything_that_says_how_to_move_moves_alike(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    asset, file = pcore.load(runs["lit"]), tmp_path / "edit.json"
    file.write_text(json.dumps(TWISTED))
    script = pcore.parse_edit(TWISTED)
    session = asset.session()
    state = session.do(TWIST)
    ways = [file, str(file), TWISTED, script, pcore.load_animation(file), session, state]
    ways += [state.bound, script.bind(asset.points)]
    points = [asset.pose(way).points for way in ways]
    assert all(torch.equal(one, points[0]) for one in points)
    assert not torch.equal(points[0], asset.points)


def test_moved_points_are_drawn_like_the_map_that_moved_them(
    runs: dict[str, Path], camera: Camera
) -> None:
    asset, grown = pcore.load(runs["lit"]), uniform_scale(1.5)
    posed = asset.pose(grown)
    moved = pcore.MovedPoints(positions=posed.points, local_maps=posed.local_maps)
    drawn, again = (asset.render(asset.pose(one), camera) for one in (grown, moved))
    torch.testing.assert_close(drawn.rgb, again.rgb, atol=1e-6, rtol=0)
    plain = asset.pose(moved, rays="plain")
    assert plain.local_maps is None
    assert asset.pose(grown, rays="plain").local_maps is None


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (7, "got int"),
        (pcore.MovedPoints(positions=torch.zeros(3, 3)), "all 80 points of the asset, got 3"),
        (pcore.EditSession(torch.rand(80, 3)), "edits bound to the 80 points of this asset"),
        (pcore.EditSession(torch.rand(5, 3)).state, "got edits of 5 others"),
    ],
)
def test_what_cannot_be_posed(runs: dict[str, Path], edit: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        pcore.load(runs["plain"]).pose(edit)


def test_keyframes_need_a_time(runs: dict[str, Path], tmp_path: Path) -> None:
    asset, moving = pcore.load(runs["plain"]), write_moving_edit(tmp_path / "moving.json")
    with pytest.raises(EditError, match=r"--time between 0 and 1 \(time= in Python\)"):
        asset.pose(moving)
    still = asset.pose({"version": 2, "edits": [{**TWIST, "angle_deg": 30}]})
    assert torch.equal(asset.pose(moving, time=0.5).points, still.points)


def test_a_fold_is_refused_where_it_shows(runs: dict[str, Path]) -> None:
    asset, fold = pcore.load(runs["plain"]), {"type": "taper", "axis": "z", "factor": -9}
    edit = {"version": 2, "edits": [fold]}
    with pytest.raises(EditError, match="singular deformation"):
        asset.pose(edit)
    assert asset.pose(edit, rays="plain").points.isfinite().all()


def test_a_light_that_is_not_there(runs: dict[str, Path]) -> None:
    asset = pcore.load(runs["plain"])
    assert asset.light is None
    with pytest.raises(InputError, match=r"expected a light\.safetensors"):
        asset.pose(light="still")


def test_damaged_companions_are_said_when_they_are_needed(tmp_path: Path, camera: Camera) -> None:
    runs = write_runs(tmp_path)
    (runs["lit"] / LIGHT_FILE).write_bytes(b"damaged")
    asset = pcore.load(runs["lit"])
    assert asset.render(asset.pose(light="baked"), camera).rgb.isfinite().all()
    with pytest.raises(CheckpointError, match="is damaged"):
        asset.pose()
    (runs["rigged"] / SKINNING_FILE).write_bytes(b"damaged")
    rigged = pcore.load(runs["rigged"])
    assert rigged.pose().points.shape == (80, 3)
    with pytest.raises(CheckpointError, match="is damaged"):
        rigged.pose(TWISTED)


@pytest.mark.parametrize("name", RUNS)
def test_what_is_saved_is_the_same_asset(
    runs: dict[str, Path], tmp_path: Path, camera: Camera, name: str
) -> None:
    edit = write_edits(tmp_path, runs)[name]
    asset = pcore.load(runs[name])
    saved = asset.save(tmp_path / "deep" / "copy")
    again = pcore.load(tmp_path / "deep" / "copy")
    assert saved.path == again.path == tmp_path / "deep" / "copy"
    assert again.provenance == asset.provenance
    assert again.record.factor == asset.record.factor
    folder, own = again.record.scene_folder, asset.record.scene_folder
    assert folder is not None
    assert own is not None
    assert folder.samefile(own)
    first, second = (one.render(one.pose(edit), camera) for one in (asset, again))
    assert torch.equal(first.rgb, second.rgb)
    with pytest.raises(InputError, match="holds a run already"):
        asset.save(tmp_path / "deep" / "copy")


def test_a_tuned_copy_still_knows_what_it_was_tuned_from(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    asset = pcore.load(runs["plain"])
    record = replace(asset.record, config={**asset.record.config, "base": "../lit"})
    moved = replace(asset, record=record).save(tmp_path / "far" / "copy")
    assert moved.record.base is not None
    assert moved.record.base.samefile(runs["lit"])


def test_what_is_in_memory_can_be_drawn_and_saved(tmp_path: Path, camera: Camera) -> None:
    asset = asset_of(Papr(CONFIG).eval(), toy_cloud(), scene="ball", step=3)
    assert len(asset) == 40
    with pytest.raises(InputError, match=r"write it with `asset\.save\(FOLDER\)`"):
        _ = asset.path
    drawn = asset.render(None, camera).rgb
    again = asset.save(tmp_path / "run")
    assert torch.equal(again.render(None, camera).rgb, drawn)
    loaded = pcore.load(str(tmp_path / "run"))
    assert torch.equal(loaded.render(None, camera).rgb, drawn)
    assert (loaded.provenance.scene, loaded.provenance.step) == ("ball", 3)


def test_a_bare_model_file_knows_no_folder(runs: dict[str, Path]) -> None:
    asset = pcore.load(runs["lit"] / MODEL_FILE)
    assert asset.light is None
    assert asset.rig is None
    assert asset.record.scene_folder is None
    with pytest.raises(InputError, match="not recorded"):
        asset.scene()


def test_several_cameras_and_their_progress(runs: dict[str, Path]) -> None:
    asset, shares = pcore.load(runs["plain"]), list[float]()
    cameras = [toy_cameras(1, size=8)[0], toy_cameras(1, size=12)[0]]
    pictures = asset.render(None, cameras, progress=shares.append)
    assert [tuple(one.rgb.shape) for one in pictures] == [(8, 8, 3), (12, 12, 3)]
    for camera, picture in zip(cameras, pictures, strict=True):
        assert torch.equal(asset.render(None, camera).rgb, picture.rgb)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_another_background(runs: dict[str, Path], camera: Camera) -> None:
    asset = pcore.load(runs["plain"])
    black, white = (asset.over((one,) * 3).render(None, camera) for one in (0.0, 1.0))
    torch.testing.assert_close(
        white.rgb - black.rgb, (1 - white.alpha)[..., None].expand(-1, -1, 3), atol=1e-6, rtol=0
    )


def test_rays_have_gradients(runs: dict[str, Path], camera: Camera) -> None:
    asset = pcore.load(runs["plain"])
    content = asset.content
    assert isinstance(content, NeuralPoints)
    positions = content.cloud.positions.clone().requires_grad_()
    cloud = replace(content.cloud, positions=positions)
    posed = replace(asset.pose(), content=PosedCloud.at_rest(cloud))
    traced = asset.trace(posed, camera.rays())
    drawn = asset.render(posed, camera, samples=1)
    torch.testing.assert_close(traced.rgb, drawn.rgb, atol=1e-5, rtol=0)
    for image in (traced, drawn):
        (gradient,) = torch.autograd.grad(image.rgb.sum(), positions)
        assert float(gradient.abs().max()) > 0


def test_a_deformation_is_fitted_through_the_door(runs: dict[str, Path], camera: Camera) -> None:
    """Gradients reach a parameter of a deformation, and a batch of cameras."""
    asset = pcore.load(runs["lit"])
    angle = torch.tensor(0.2, dtype=torch.float64, requires_grad=True)
    cameras = Camera.stack(toy_cameras(3, size=8))
    image = asset.render(asset.pose(Swirl(angle), light="baked"), cameras, samples=1)
    assert image.rgb.shape == (3, 8, 8, 3)
    (gradient,) = torch.autograd.grad(image.rgb.square().mean(), angle)
    assert float(gradient.abs()) > 0
    with pytest.raises(InputError, match="a gradient is asked for, and shadows have none"):
        asset.pose(Swirl(angle))


def test_depth_does_not_depend_on_the_light(runs: dict[str, Path], camera: Camera) -> None:
    asset, swirl = pcore.load(runs["lit"]), Swirl(torch.tensor(0.4))
    for motion in (None, swirl):
        lit, baked = (
            asset.render(asset.pose(motion, light=light), camera) for light in ("still", "baked")
        )
        assert (motion is None) == torch.equal(lit.rgb, baked.rgb)
        for name in ("alpha", "depth", "surface"):
            one, other = getattr(lit, name), getattr(baked, name)
            assert torch.equal(one.nan_to_num(7.0), other.nan_to_num(7.0)), name


@dataclass(frozen=True)
class Swirl(pcore.Deformation):
    """A twist about z whose angle, radians per unit, is a parameter."""

    angle: Tensor

    def __call__(self, points: Tensor) -> Tensor:
        x, y, z = points.unbind(dim=-1)
        cos, sin = (self.angle * z).cos(), (self.angle * z).sin()
        return torch.stack([cos * x - sin * y, sin * x + cos * y, z], dim=-1)


def test_an_asset_says_how_it_is_tuned(runs: dict[str, Path]) -> None:
    asset = pcore.load(runs["plain"])
    assert finetune_settings(asset)[0] == "paper"
    tiny = replace(asset, record=replace(asset.record, config={"preset": "tiny"}))
    assert finetune_settings(tiny)[0] == "tiny"
    assert finetune_settings(tiny, "fast")[0] == "fast"
    assert finetune_settings(tiny.over((0.0, 0.0, 0.0)))[1].background == "black"
