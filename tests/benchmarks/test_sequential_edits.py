"""Holes over what a view shows at rest, carried along by edits."""

from dataclasses import replace

import torch
from benchmarks.sequential_edits import _box, holes, own_edits, surface_of

import tiny_scene
from pcore.asset.meshing import moved_mesh
from pcore.deform.simple import uniform_scale
from pcore.editing.script import parse_edit
from pcore.geometry.camera import Camera
from pcore.render.image import Image

SIZE = 2.0


def picture(camera: Camera, scale: float = 1.0) -> Image:
    """The box, truly."""
    rgba, depth = tiny_scene.see(scale * tiny_scene.CORNERS, camera)
    depth = torch.where(depth.isfinite(), depth, torch.nan)
    rays = camera.rays()
    forward = -camera.world_from_camera[:3, 2]
    along = depth[..., None] / (rays.directions * forward).sum(dim=-1, keepdim=True)
    surface = torch.nan_to_num(rays.origins.expand_as(rays.directions) + along * rays.directions)
    return Image(rgb=rgba[..., :3], alpha=rgba[..., 3], depth=depth, surface=surface)


def test_nothing_is_missing_at_rest_nor_where_the_picture_follows() -> None:
    camera = tiny_scene.orbit(8)[1]
    mesh = surface_of(picture(camera), camera)
    assert len(mesh) > 50
    rest = holes(picture(camera), mesh, camera, SIZE)
    assert (rest.hole_rate, rest.off_rate) == (0, 0)
    grown = moved_mesh(mesh, uniform_scale(1.3))
    followed = holes(picture(camera, 1.3), grown, camera, SIZE)
    assert (followed.hole_rate, followed.see_through_rate) == (0, 0)
    assert followed.solid_pixels > 1.3 * rest.solid_pixels


def test_holes_are_see_through_or_show_what_is_behind() -> None:
    camera = tiny_scene.orbit(8)[1]
    whole = picture(camera)
    mesh = surface_of(whole, camera)
    torn = replace(whole, alpha=torch.zeros_like(whole.alpha))
    assert holes(torn, mesh, camera, SIZE).see_through_rate == 1
    deep = holes(replace(whole, depth=whole.depth + 0.2), mesh, camera, SIZE)
    assert (deep.hole_rate, deep.see_through_rate, deep.off_rate) == (1, 0, 1)
    # Something that has moved in front is no hole.
    near = holes(replace(whole, depth=whole.depth - 0.2), mesh, camera, SIZE)
    assert (near.hole_rate, near.off_rate) == (0, 1)


def test_the_edits_fit_any_object_and_the_figure_is_cut_to_it() -> None:
    cameras = tiny_scene.orbit(8)
    points = 100 * torch.rand(500, 3, generator=torch.Generator().manual_seed(0)) + 1000
    edits = own_edits(points, cameras)
    assert [one["type"] for one in edits] == ["twist", "bend", "part"]
    bound = parse_edit({"version": 2, "edits": edits}).bound(points)
    assert float((bound.setting.points - points).norm(dim=-1).max()) > 5
    assert edits[2]["origin"][2] > points[:, 2].median()
    alpha = torch.zeros(2, 40, 40)
    alpha[1, 10:20, 5:30] = 1
    rows, columns = _box(alpha)
    assert (rows.start, rows.stop, columns.start, columns.stop) == (9, 21, 3, 32)
