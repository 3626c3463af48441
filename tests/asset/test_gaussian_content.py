"""Objects of Gaussians through the one door: trained, loaded, posed, drawn, saved."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import cast

import pytest
import torch

import pcore
from pcore.asset.asset import Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.saving import asset_of, load
from pcore.asset.training import RunOptions, train
from pcore.capture.load import load_scene
from pcore.cli.main import main
from pcore.deform.simple import uniform_scale
from pcore.errors import InputError
from pcore.gaussians.carry import carried
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.wide_pixels import pixel_width
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras
from pcore.geometry.pixel_samples import grid_places
from pcore.training.gaussian_config import DensityConfig, GaussianConfig
from tiny_scene import write_scene

CONFIG = GaussianConfig(
    steps=6, points=40, density=DensityConfig(every=2, first=2, limit=50), hold_out=3
)


def an_asset(count: int = 60, degree: int = 1) -> Asset:
    draw = torch.Generator().manual_seed(2)
    gaussians = Gaussians(
        means=0.3 * torch.randn(count, 3, generator=draw),
        quats=torch.nn.functional.normalize(torch.randn(count, 4, generator=draw), dim=-1),
        scales=0.05 + 0.1 * torch.rand(count, 3, generator=draw),
        opacities=0.2 + 0.7 * torch.rand(count, generator=draw),
        sh=0.3 * torch.randn(count, (degree + 1) ** 2, 3, generator=draw),
    )
    return asset_of(gaussians)


def camera(distance: float = 4.0) -> Camera:
    (one,) = orbit_cameras(
        torch.zeros(3), distance, 1, elevation=0.3, width=40, height=32, angle_x=0.6
    )
    return one


def test_wide_pixels_are_divided_unless_frames_are_quick() -> None:
    plain, seen = an_asset(), camera()
    content = cast(GaussianContent, plain.content)
    pixel = pixel_width(content.gaussians, seen)
    known = replace(content, footprint=replace(content.footprint, pixel=pixel))
    asset, half = replace(plain, content=known), seen.resized(20, 16)
    fine = asset.render(None, seen).rgb
    mean = fine.reshape(16, 2, 20, 2, 3).mean(dim=(1, 3))
    torch.testing.assert_close(asset.render(None, half).rgb, mean)
    assert torch.equal(asset.render(None, half, fast=True).rgb, plain.render(None, half).rgb)
    assert torch.equal(fine, plain.render(None, seen).rgb)


def test_what_is_trained_in_a_folder_is_what_is_loaded_and_what_memory_gives(
    tmp_path: Path,
) -> None:
    scene = load_scene(write_scene(tmp_path / "box", states=False))
    notes: list[str] = []
    options = RunOptions(note=notes.append)
    made = train(scene, CONFIG, folder=tmp_path / "run", options=options)
    # Six steps make no surface that light could fall on.
    assert "at least 50 points with a normal" in notes[-1]
    assert made.light is None
    found = load(tmp_path / "run")
    assert len(found) == len(made) == 50
    assert found.provenance.scene == "box"
    assert found.record.config["model"] == "gaussians"
    here = train(scene, CONFIG)
    for one in (made, here):
        picture, truth = one.render(None, camera()), found.render(None, camera())
        assert torch.equal(picture.rgb, truth.rgb)
    again = here.save(tmp_path / "saved")
    assert torch.equal(again.render(None, camera()).rgb, here.render(None, camera()).rgb)
    assert pcore.load(tmp_path / "saved").points.shape == (50, 3)


def test_a_scaled_object_looks_like_one_that_is_nearer() -> None:
    """Means and shapes grow: twice as large, seen from twice as far, is the same picture."""
    asset = an_asset()
    posed = asset.pose(uniform_scale(2.0))
    near, far = asset.render(None, camera(4.0)), asset.render(posed, camera(8.0))
    torch.testing.assert_close(far.rgb, near.rgb, atol=2e-4, rtol=0)
    torch.testing.assert_close(far.alpha, near.alpha, atol=2e-4, rtol=0)
    solid = near.alpha > 0.5
    torch.testing.assert_close(far.depth[solid], 2 * near.depth[solid], atol=2e-3, rtol=0)
    plain = asset.pose(uniform_scale(2.0), rays="plain")
    assert float((asset.render(plain, camera(8.0)).rgb - near.rgb).abs().mean()) > 0.01
    assert torch.equal(plain.points, posed.points)
    assert plain.local_maps is None
    assert posed.local_maps is not None


def test_the_surface_lies_at_the_depth() -> None:
    found = an_asset().render(None, camera())
    solid = found.alpha > 0.5
    torch.testing.assert_close(
        camera().depth(found.surface[solid]), found.depth[solid], atol=1e-4, rtol=0
    )
    empty = found.alpha == 0
    assert bool(empty.any())
    assert bool(found.depth[empty].isnan().all())


def test_the_background_can_be_changed() -> None:
    asset = an_asset()
    black, white = asset.over((0.0, 0.0, 0.0)).render(None, camera()), asset.render(None, camera())
    torch.testing.assert_close(
        white.rgb - black.rgb, (1 - white.alpha)[..., None].expand(-1, -1, 3), atol=1e-6, rtol=0
    )


def test_several_cameras_and_sizes() -> None:
    asset = an_asset()
    pictures = asset.render(None, [camera(), camera().resized(16, 12)])
    assert [tuple(one.rgb.shape) for one in pictures] == [(32, 40, 3), (12, 16, 3)]
    assert asset.film_detail([asset.pose()], [camera()]) is None


def test_what_gaussians_cannot_do_is_said() -> None:
    asset = an_asset()
    assert asset.light is None
    with pytest.raises(InputError, match="estimate it"):
        asset.pose(light="still")


def test_rays_are_lines_whose_mean_over_a_pixel_is_the_picture() -> None:
    asset = an_asset()
    posed, view = asset.pose(uniform_scale(1.2)), camera(8.0)
    picture = asset.render(posed, view)
    places = grid_places(9)
    found = asset.trace(posed, view.rays(places=places))
    assert found.alpha.shape == (view.height, view.width)
    solid = picture.alpha > 0.5
    apart = (found.rgb - picture.rgb)[solid].abs()
    assert float(apart.mean()) < 0.02
    one = asset.trace(posed, view.rays().flat())
    assert one.surface.shape == (view.height * view.width, 3)
    assert bool(torch.isnan(one.depth[one.alpha == 0]).all())
    distance = (one.surface - view.center).norm(dim=-1)
    torch.testing.assert_close(distance[one.alpha > 0], one.depth[one.alpha > 0])


def test_an_edit_file_carries_gaussians() -> None:
    """What is drawn of an edit is what is drawn of Gaussians that were written out carried."""
    asset = an_asset(300)
    twist = {"type": "twist", "axis": "z", "angle_deg": 60}
    posed = asset.pose({"version": 2, "edits": [twist]})
    assert posed.local_maps is not None
    maps = torch.linalg.inv(posed.local_maps.to_rest)
    content = cast("GaussianContent", asset.content)
    written = replace(content, gaussians=carried(content.gaussians, posed.points, maps))
    truth = replace(asset, content=written).render(None, camera())
    assert float((asset.render(posed, camera()).rgb - truth.rgb).abs().mean()) < 1e-4
    assert float((asset.render(None, camera()).rgb - truth.rgb).abs().mean()) > 1e-3


def test_a_bare_file_of_gaussians_is_an_object_under_any_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asset = an_asset()
    asset.save(tmp_path / "run")
    file = (tmp_path / "run" / "gaussians.safetensors").rename(tmp_path / "ball.safetensors")
    found = load(file)
    assert torch.equal(found.points, asset.points)
    assert torch.equal(found.render(None, camera()).rgb, asset.render(None, camera()).rgb)
    assert main(["info", str(file)]) == 0
    assert f"{len(asset):,}" in capsys.readouterr().out
