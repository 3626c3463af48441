"""Gaussians in a light that stands still, through the one door."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from tests.render.test_gaussian_surfels import COUNT, a_ball, photos

import pcore
from pcore.asset.asset import Asset
from pcore.asset.content import MovedPoints
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.saving import asset_of
from pcore.cli.main import main
from pcore.errors import CheckpointError, InputError
from pcore.files.gaussian_file import GAUSSIANS_FILE
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.surfels import Surfels
from pcore.relight.description import describe_light
from pcore.relight.gaussian_light import lit_of
from pcore.relight.lamps import Light, sphere
from pcore.relight.light_file import LIGHT_FILE
from pcore.relight.relighting import Relighting

TURN: dict[str, Any] = {
    "version": 2,
    "edits": [{"type": "rigid", "axis": "x", "angle_deg": 120}],
}


def dark_asset() -> Asset:
    return asset_of(a_ball())


def lit_asset() -> Asset:
    """The ball under a lamp from above; three Gaussians have no normal."""
    asset = dark_asset()
    normals = torch.cat([sphere(COUNT), torch.zeros(3, 3)])
    lit, points = lit_of(normals), asset.points
    surfels = Surfels.at_rest(points[lit], normals[lit], torch.zeros(len(lit)))
    directions = sphere(40)
    light = Light(
        directions=directions,
        radiance=0.1 + (4 * directions[:, 2] - 2).exp(),
        nearness=torch.zeros(40),
        center=torch.zeros(3),
    )
    relighting = Relighting.of(light, points[lit], surfels, torch.full((len(lit),), 0.3))
    content = replace(
        cast("GaussianContent", asset.content), normals=normals, read_light=lambda: relighting
    )
    return replace(asset, content=content)


def gains(asset: Asset, edit: object, **how: Any) -> torch.Tensor | None:
    return asset.pose(cast("Any", edit), **how).content.drawn.gains


def test_a_light_stands_still_unless_asked_otherwise() -> None:
    asset = lit_asset()
    found = gains(asset, TURN)
    assert found is not None
    assert found.shape == (COUNT + 3, 1)
    assert float(found.log().abs().mean()) > 0.2
    assert torch.equal(found, cast("torch.Tensor", gains(asset, TURN, light="still")))
    assert gains(asset, TURN, light="baked") is None
    assert gains(asset, TURN, rays="plain") is None
    assert gains(asset, None) is None
    unit = LocalMaps(to_rest=torch.eye(3).repeat(COUNT + 3, 1, 1))
    still = gains(asset, MovedPoints(positions=asset.points, local_maps=unit))
    torch.testing.assert_close(still, torch.ones(COUNT + 3, 1), atol=1e-5, rtol=0)


def test_gradients_are_refused_where_shadows_have_none() -> None:
    turned = MovedPoints(
        positions=lit_asset().points.clone().requires_grad_(True),
        local_maps=LocalMaps(to_rest=torch.eye(3).expand(COUNT + 3, 3, 3)),
    )
    with pytest.raises(InputError, match="a gradient is asked for, and shadows have none"):
        lit_asset().pose(turned)
    assert lit_asset().pose(turned, light="baked").points.requires_grad
    with torch.no_grad():
        assert gains(lit_asset(), turned) is not None


def test_a_light_that_is_not_there() -> None:
    with pytest.raises(InputError, match="pcore light RUN"):
        dark_asset().pose(TURN, light="still")


def test_what_is_saved_is_lit_alike(tmp_path: Path) -> None:
    asset = lit_asset()
    asset.save(tmp_path / "run")
    again = pcore.load(tmp_path / "run")
    assert torch.equal(
        cast("torch.Tensor", gains(again, TURN)), cast("torch.Tensor", gains(asset, TURN))
    )
    assert again.light is not None
    assert again.content.surfels is not None
    told = describe_light(again.light, again.content.surfels)
    assert told.startswith("brightest on surfaces that face (")
    assert "99 % of the points have a normal" in told


@pytest.mark.parametrize("light", [(), ("--light", "baked")])
def test_python_draws_what_the_command_draws(tmp_path: Path, light: tuple[str, ...]) -> None:
    run, edit = tmp_path / "run", tmp_path / "turn.json"
    lit_asset().save(run)
    edit.write_text(json.dumps(TURN))
    words = ("render", run, "--orbit", 2, "--size", 24, 16, "--raw", "--edit", edit, *light)
    assert main([*map(str, (*words, "-o", tmp_path / "out")), "--device", "cpu"]) == 0
    asset = pcore.load(run)
    posed = asset.pose(edit, light="baked" if light else None)
    cameras = pcore.orbit_around(posed.points, 2, size=(24, 16))
    files = sorted((tmp_path / "out").glob("*.npz"))
    for file, picture in zip(files, asset.film([posed] * 2, cameras), strict=True):
        with np.load(file) as raw:
            np.testing.assert_array_equal(raw["rgb"], picture.rgb.numpy())
            np.testing.assert_array_equal(raw["depth"], picture.depth.numpy())


def test_photos_tell_the_light(tmp_path: Path) -> None:
    """The ball's sides have colours of their own: enough for a light, whatever it is."""
    asset = dark_asset()
    content = cast("GaussianContent", asset.content)
    made = content.with_light(photos(content.gaussians))
    assert made.normals is not None
    assert made.light is not None
    assert len(made.light.positions) == len(lit_of(made.normals)) > 0.9 * COUNT
    saved = replace(asset, content=made).save(tmp_path / "run")
    assert saved.light is not None
    assert torch.equal(pcore.load(tmp_path / "run").content.points, asset.points)


def write_photos(folder: Path) -> Path:
    (folder / "train").mkdir(parents=True)
    frames: list[dict[str, Any]] = []
    for number, view in enumerate(photos(a_ball())):
        pixels = (255 * view.rgba()).round().to(torch.uint8).numpy()
        Image.fromarray(pixels).save(folder / "train" / f"r_{number}.png")
        pose = view.camera.world_from_camera.tolist()
        frames.append({"file_path": f"./train/r_{number}", "transform_matrix": pose})
    text = json.dumps({"camera_angle_x": 0.6, "frames": frames})
    (folder / "transforms_train.json").write_text(text)
    return folder


def test_python_estimates_what_the_command_estimates(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, run = write_photos(tmp_path / "photos"), tmp_path / "run"
    dark_asset().save(run)
    made = pcore.estimate_light(dark_asset(), pcore.load_scene(scene))
    assert main(["light", str(run), "--scene", str(scene), "--device", "cpu"]) == 0
    found = pcore.load(run)
    assert "brightest on surfaces that face" in capsys.readouterr().out
    assert torch.equal(
        cast("torch.Tensor", gains(found, TURN)), cast("torch.Tensor", gains(made, TURN))
    )


def test_normals_and_lights_of_others_are_refused(tmp_path: Path) -> None:
    lit_asset().save(tmp_path / "run")
    path = tmp_path / "run" / GAUSSIANS_FILE
    good = path.read_bytes()
    with safe_open(path, framework="pt") as file:
        header = file.metadata()
    tensors = load_file(path)
    save_file({**tensors, "normals": 2 * tensors["normals"]}, path, metadata=header)
    with pytest.raises(CheckpointError, match="unit length"):
        pcore.load(tmp_path / "run")
    save_file({**tensors, "normals": tensors["normals"][1:]}, path, metadata=header)
    with pytest.raises(CheckpointError, match="expected normals"):
        pcore.load(tmp_path / "run")
    normals = tensors["normals"].clone()
    normals[0] = 0
    save_file({**tensors, "normals": normals}, path, metadata=header)
    asset = pcore.load(tmp_path / "run")
    with pytest.raises(CheckpointError, match="others"):
        asset.pose(TURN)
    assert asset.pose(TURN, light="baked") is not None
    path.write_bytes(good)
    (tmp_path / "run" / LIGHT_FILE).unlink()
    assert pcore.load(tmp_path / "run").light is None
