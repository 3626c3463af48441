"""Photos tell where the surface over points lies, and what colour it has."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.geometry.camera import Camera
from pcore.geometry.light import sphere
from pcore.geometry.point_cloud import PointCloud
from pcore.model.shading import spacing_of
from pcore.training import light_photos
from pcore.training.light_photos import Shown, colors_at, height_of, observe

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


def photos(count: int = 16, deeper: float = 0.0) -> list[Shown]:
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

    monkeypatch.setattr(light_photos, "_look", look)
    cloud = PointCloud(
        positions=positions, features=torch.zeros(1000, 1), influence=torch.ones(1000)
    )
    papr: Any = torch.nn.Linear(1, 1)
    views: Sequence[Any] = range(len(shown))
    told: list[tuple[int, int]] = []
    found = observe(papr, cloud, views, progress=lambda *step: told.append(step))
    assert found.lift == pytest.approx(inside, abs=0.006)
    known = found.normals.norm(dim=1) > 0.5
    assert int((~known).sum()) == 100
    torch.testing.assert_close(found.normals[known], outwards[known])
    assert float((found.colors[known] - painted(outwards[known])).abs().mean()) < 0.02
    assert torch.equal(found.colors[~known], torch.zeros(100, 3))
    assert torch.equal(found.attention, torch.where(known, 20.0, 0.0))
    assert told == [(step, 20) for step in range(1, 21)]
    # Of one photo nothing can be told.
    alone = observe(papr, cloud, [0])
    assert alone.lift == 0.0
    assert torch.equal(alone.colors[known], torch.full((900, 3), 0.5))


def test_of_many_views_some_are_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[int] = []

    def look(_: Any, __: Any, view: int, sums: Tensor) -> Any:
        sums[:, 6] += 1
        return SimpleNamespace(number=view)

    def no_height(_: Tensor, __: Tensor, shown: Sequence[Any], ___: float) -> float:
        kept.extend(one.number for one in shown)
        return 0.0

    monkeypatch.setattr(light_photos, "_look", look)
    monkeypatch.setattr(light_photos, "height_of", no_height)
    monkeypatch.setattr(
        light_photos, "colors_at", lambda places, *_: torch.full_like(places, math.nan)
    )
    cloud = PointCloud(positions=sphere(50), features=torch.zeros(50, 1), influence=torch.ones(50))
    papr: Any = torch.nn.Linear(1, 1)
    views: Any = range(101)
    assert torch.equal(observe(papr, cloud, views).attention, torch.full((50,), 101.0))
    assert kept == list(range(2, 101, 3))
