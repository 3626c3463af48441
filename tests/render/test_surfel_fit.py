"""Photos tell where the surface over points lies, and what colour it has."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

import tiny_scene
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.surfels import spacing_of
from pcore.model.papr import Papr
from pcore.relight.lamps import sphere
from pcore.render import surfel_fit
from pcore.render.surfel_fit import Shown, colors_at, height_of, observe

lowest, look = surfel_fit._lowest, surfel_fit._look

SIZE = 120


def painted(places: Tensor) -> Tensor:
    """A pattern (..., 3) finer than a photo's depth is wrong by."""
    phases = 14 * places + torch.tensor([0.0, 1.0, 2.0])
    return 0.5 + 0.4 * torch.sin(phases)


def towards_the_middle(eye: Tensor) -> Tensor:
    """World from camera (4, 4) of a camera at (3,) that looks at the origin."""
    back = F.normalize(eye, dim=0)
    right = F.normalize(torch.linalg.cross(torch.tensor([0.3, 1.0, 0.2]), back), dim=0)
    pose = torch.eye(4)
    pose[:3] = torch.stack([right, torch.linalg.cross(back, right), back, eye], dim=1)
    return pose


def ball_photo(eye: Tensor, deeper: float = 0.0) -> Shown:
    """A photo of a painted ball of radius 1, whose predicted depth is too large by something."""
    camera = Camera.from_fov(
        towards_the_middle(eye), width=SIZE, height=SIZE, angle_x=math.radians(40)
    )
    rays = camera.rays().flat()
    middle = -(rays.origins * rays.directions).sum(dim=1)
    apart = rays.origins.square().sum(dim=1) - middle.square()
    hit = apart < 1
    along = middle - (1 - apart).clamp_min(0).sqrt()
    places = rays.origins + along[:, None] * rays.directions
    rgb = torch.where(hit[:, None], painted(places), 1.0).reshape(SIZE, SIZE, 3)
    depth = camera.depth((places + deeper * rays.directions).reshape(SIZE, SIZE, 3))
    depth = depth.masked_fill(~hit.reshape(SIZE, SIZE), math.nan)
    return Shown(camera=camera, rgb=rgb, depth=depth)


def photos(count: int = 24, deeper: float = 0.0) -> list[Shown]:
    return [ball_photo(3.5 * eye, deeper) for eye in sphere(count)]


@pytest.mark.parametrize("inside", [0.0, 0.02, 0.05])
def test_the_surface_is_where_photos_agree(inside: float) -> None:
    """Points lie too deep, and so does the predicted surface: the mean of points."""
    normals = sphere(2000)
    points = (1 - inside) * normals
    spacing = spacing_of(points)
    found = height_of(points, normals, photos(deeper=inside), spacing) * spacing
    assert found == pytest.approx(inside, abs=0.006)


def test_photos_that_cannot_tell() -> None:
    normals = sphere(500)
    assert height_of(normals, normals, [], 0.05) == 0.0
    assert height_of(normals, normals, photos(2), 0.05) == 0.0, "no point is in four photos"
    assert height_of(normals[:0], normals[:0], photos(4), 0.05) == 0.0
    assert height_of(normals, -normals, photos(4), 0.05) == 0.0, "nothing faces a camera"


@pytest.mark.parametrize("inside", [0.0, 0.03])
def test_paint_without_a_pattern_tells_no_height(inside: float) -> None:
    """Grey, or grey and noise, is the same at every height: the surface is that of the points."""
    normals = sphere(1000)
    for noise in (0.0, 0.05):
        draw = torch.Generator().manual_seed(2)
        grey = [
            replace(one, rgb=0.5 + noise * torch.randn(SIZE, SIZE, 3, generator=draw))
            for one in photos(deeper=inside)
        ]
        assert height_of((1 - inside) * normals, normals, grey, 0.1) == 0.0


def test_the_height_is_where_a_parabola_is_least() -> None:
    places = [0.2 * step for step in range(-1, 8)]
    for least in (-0.05, 0.35, 0.9, 1.3):
        found = lowest(places, [(place - least) ** 2 + 1 for place in places])
        assert found == pytest.approx(least)
    assert lowest(places, places) == -0.2
    assert lowest(places, [-place for place in places]) == pytest.approx(1.4)
    assert lowest(places, [1.0] * 9) == -0.2


def test_the_median_of_points_decides_and_all_heights_have_the_same_points() -> None:
    """A fifth of the points show noise wherever they are; few of the others are in four photos."""
    normals = sphere(1500)
    inside = 0.04
    points = (1 - inside) * normals
    shown = photos(deeper=inside)
    odd = normals[:, 2] > 0.6

    def noisy(one: Shown) -> Shown:
        draw = torch.Generator().manual_seed(int(1000 * one.camera.center[0]) % 97)
        rays = one.camera.rays()
        places = (
            rays.origins
            + (one.depth / -(rays.directions @ one.camera.world_from_camera[:3, 2])).unsqueeze(2)
            * rays.directions
        )
        noise = torch.rand(SIZE, SIZE, 3, generator=draw)
        return replace(one, rgb=torch.where(places[..., 2:] > 0.6, noise, one.rgb))

    spacing = spacing_of(points)
    found = height_of(points, normals, [noisy(one) for one in shown], spacing) * spacing
    assert int(odd.sum()) == 300
    assert found == pytest.approx(inside, abs=0.006)


def test_what_lies_beside_the_object_has_no_say_in_its_rim() -> None:
    """A grey bar two pixels wide on black that is not solid: grey everywhere, never darker."""
    eye = torch.tensor([0.0, 0.0, 3.5])
    one = ball_photo(eye)
    column = torch.arange(SIZE)
    bar = (column >= 60) & (column < 62)
    rgb = torch.where(bar[None, :, None], 0.5, 0.0).expand(SIZE, SIZE, 3)
    depth = torch.full((SIZE, SIZE), 3.5).masked_fill(~bar, math.nan)
    photo = Shown(camera=one.camera, rgb=rgb, depth=depth)
    width = 2 * 3.5 * math.tan(math.radians(20)) / SIZE
    across = (torch.arange(40) / 10 - 1) * width
    # The bar lies to the right of the middle, wherever that is in the world.
    right = one.camera.world_from_camera[:3, 0]
    places = across[:, None] * right
    up = F.normalize(eye, dim=0).expand(40, 3)
    found = colors_at(places, up, [photo, photo], spacing=0.1)
    inside = (across > 0) & (across < 2 * width)
    edge = (across.abs() < 1e-6) | ((across - 2 * width).abs() < 1e-6)
    torch.testing.assert_close(found[inside & ~edge], torch.full_like(found[inside & ~edge], 0.5))
    assert bool(found[~inside & ~edge].isnan().all())


def test_photos_show_what_faces_them_and_is_as_far_away_as_they_say() -> None:
    """Up to 73 degrees, and within two spacings of the depth: three while heights are tried."""
    normals, eye = sphere(1500), torch.tensor([0.0, 0.0, 3.5])
    cosine = (F.normalize(eye - normals, dim=1) * normals).sum(dim=1)
    one = ball_photo(eye)
    known = ~colors_at(normals, normals, [one, one], 0.1).isnan().any(dim=1)
    assert bool(known[cosine > 0.32].all())
    assert not bool(known[cosine < 0.3].any())
    top, spacing = cosine > 0.5, 0.1
    for off, seen in ((0.17, True), (0.23, False), (-0.17, True), (-0.23, False)):
        moved = replace(one, depth=one.depth + off)
        found = colors_at(normals[top], normals[top], [moved, moved], spacing)
        assert bool((~found.isnan()).all()) is seen, off
        assert bool(found.isnan().all()) is not seen, off
    for off, seen in ((0.25, True), (0.35, False)):
        farther = [replace(each, depth=each.depth + off) for each in photos(40)]
        at_all = surfel_fit._disagreement(normals, normals, farther, spacing).isfinite()
        assert bool(at_all.any()) is seen, off


def test_the_rim_of_a_photo_is_no_darker_than_its_middle() -> None:
    one = ball_photo(torch.tensor([0.0, 0.0, 3.5]))
    white = Shown(
        camera=one.camera, rgb=torch.ones(SIZE, SIZE, 3), depth=torch.full((SIZE, SIZE), 3.5)
    )
    right = one.camera.world_from_camera[:3, 0]
    reach = 3.5 * math.tan(math.radians(20))
    places = torch.linspace(-0.999, 0.999, 60)[:, None] * reach * right
    facing = torch.tensor([[0.0, 0.0, 1.0]]).expand(60, 3)
    found = colors_at(places, facing, [white, white], spacing=0.1)
    torch.testing.assert_close(found, torch.ones(60, 3))


def test_a_view_gives_its_points_normals_and_solid_pixels_alone_are_shown() -> None:
    """Through a real network: what is not solid in the photo counts for nothing."""
    cloud = PointCloud(
        positions=0.8 * sphere(600), features=torch.randn(600, 4), influence=torch.ones(600)
    )
    papr = Papr(
        replace(tiny_scene.CONFIG, cutoff=0.3, feature_size=4, background_score=-9.0)
    ).eval()
    camera = ball_photo(torch.tensor([0.0, 0.0, 3.5])).camera.resized(40, 40)
    rgba = torch.rand(40, 40, 4)
    rgba[..., 3] = 1.0
    rgba[:, :20, 3] = 0.5
    sums = {}
    for has_alpha in (True, False):
        view: Any = SimpleNamespace(camera=camera, rgba=lambda: rgba, has_alpha=has_alpha)
        sums[has_alpha] = torch.zeros(600, 7)
        with torch.no_grad():
            shown = look(papr, PosedCloud.at_rest(cloud), view, sums[has_alpha])
        met = shown.depth.isfinite()
        assert torch.equal(shown.rgb, rgba[..., :3])
        assert bool(met[:, :20].any()) is not has_alpha
        assert bool(met[:, 20:].any())
        assert float(shown.depth[met].min()) > 2.5
    told = sums[True][:, 6] > 0.5
    assert 20 < int(told.sum()) < int((sums[False][:, 6] > 0.5).sum())
    normal = F.normalize(sums[True][told, :3], dim=1)
    outwards = F.normalize(cloud.positions[told], dim=1)
    assert float((normal * outwards).sum(dim=1).median()) > 0.8


def test_a_surface_beyond_all_that_is_tried_is_at_the_last() -> None:
    normals = sphere(2000)
    points = 0.9 * normals
    found = height_of(points, normals, photos(deeper=0.1), 0.045)
    assert found == pytest.approx(1.4)


def test_colours_are_those_of_the_surface() -> None:
    normals = sphere(1000)
    found = colors_at(normals, normals, photos(), spacing=0.1)
    assert float((found - painted(normals)).abs().mean()) < 0.01
    assert not found.isnan().any()


def test_what_a_photo_shows_in_front_is_not_the_colour_of_what_lies_behind() -> None:
    """One photo is red all over, as if something stood before the ball: its depth says so."""
    normals = sphere(1000)
    one = ball_photo(torch.tensor([0.0, 0.0, 3.5]))
    red = torch.tensor([1.0, 0.0, 0.0]).expand(SIZE, SIZE, 3)
    others = photos()
    near = Shown(camera=one.camera, rgb=red, depth=one.depth - 0.5)
    found = colors_at(normals, normals, [*others, near], spacing=0.1)
    torch.testing.assert_close(found, colors_at(normals, normals, others, spacing=0.1))
    through = Shown(camera=one.camera, rgb=red, depth=one.depth)
    assert not torch.equal(found, colors_at(normals, normals, [*others, through], spacing=0.1))


def test_colours_that_fewer_than_two_photos_show_are_not_known() -> None:
    normals = sphere(200)
    up, down = torch.tensor([0.0, 0.0, 3.5]), torch.tensor([0.3, 0.0, -3.5])
    found = colors_at(normals, normals, [ball_photo(up), ball_photo(up), ball_photo(down)], 0.1)
    known = ~found.isnan().any(dim=1)
    assert bool(known[normals[:, 2] > 0.8].all())
    assert not bool(known[normals[:, 2] < -0.1].any())
    assert bool(colors_at(normals, normals, [], 0.1).isnan().all())
    # Beside and behind a camera.
    beside = torch.tensor([[0.0, 0.0, 9.0], [40.0, 0.0, 0.0]])
    facing = F.normalize(up - beside, dim=1)
    assert bool(colors_at(beside, facing, [ball_photo(up)] * 2, 99.0).isnan().all())


def test_points_get_what_their_surface_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Colours of the surface; of the pixels around where no normal is known or no photo shows it.

    What pixels give to points is made up: normals outwards, grey, and nothing for every tenth.
    """
    outwards, inside = sphere(1000), 0.03
    positions = (1 - inside) * outwards
    shown = photos(20, deeper=inside)

    def look(_: Any, __: Any, view: int, sums: Tensor) -> Shown:
        sums[:, :3] += outwards
        sums[:, 3:6] += 0.5
        sums[:, 6] += 1
        sums[::10] = 0
        return shown[view]

    monkeypatch.setattr(surfel_fit, "_look", look)
    cloud = PointCloud(
        positions=positions, features=torch.zeros(1000, 1), influence=torch.ones(1000)
    )
    papr: Any = torch.nn.Linear(1, 1)
    views: Sequence[Any] = range(len(shown))
    told: list[tuple[int, int]] = []
    found = observe(papr, cloud, views, progress=lambda *step: told.append(step))
    assert float(found.heights.max()) == float(found.heights.min())
    assert float(found.heights[0]) == pytest.approx(inside, abs=0.006)
    known = found.normals.norm(dim=1) > 0.5
    assert int((~known).sum()) == 100
    torch.testing.assert_close(found.normals[known], outwards[known])
    assert float((found.colors[known] - painted(outwards[known])).abs().mean()) < 0.02
    assert torch.equal(found.colors[~known], torch.zeros(100, 3))
    assert torch.equal(found.attention, torch.where(known, 20.0, 0.0))
    assert told == [(step, 20) for step in range(1, 21)]
    # Of one photo nothing can be told.
    alone = observe(papr, cloud, [0])
    assert not alone.heights.any()
    surfels = found.surfels(cloud)
    torch.testing.assert_close(surfels.places, positions + found.heights[:, None] * found.normals)
    assert torch.equal(surfels.known, known)
    assert torch.equal(alone.colors[known], torch.full((900, 3), 0.5))


def test_of_many_views_some_are_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[int] = []

    def look(_: Any, __: Any, view: int, sums: Tensor) -> Any:
        sums[:, 6] += 1
        return SimpleNamespace(number=view)

    def no_height(_: Tensor, __: Tensor, shown: Sequence[Any], ___: float) -> float:
        kept.extend(one.number for one in shown)
        return 0.0

    monkeypatch.setattr(surfel_fit, "_look", look)
    monkeypatch.setattr(surfel_fit, "height_of", no_height)
    monkeypatch.setattr(
        surfel_fit, "colors_at", lambda places, *_: torch.full_like(places, math.nan)
    )
    cloud = PointCloud(positions=sphere(50), features=torch.zeros(50, 1), influence=torch.ones(50))
    papr: Any = torch.nn.Linear(1, 1)
    views: Any = range(101)
    assert torch.equal(observe(papr, cloud, views).attention, torch.full((50,), 101.0))
    assert len(kept) == 50
    assert kept == sorted(kept)
    assert {after - before for before, after in itertools.pairwise(kept)} == {2}
    kept.clear()
    observe(papr, cloud, views[:50])
    assert kept == list(range(50)), "as many as are compared are all compared"
