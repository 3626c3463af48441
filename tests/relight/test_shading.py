"""How points change when an edit turns and moves them in a light that stands still."""

import math
from dataclasses import replace

import pytest
import torch

from pcore.errors import InputError
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.surfels import Surfels
from pcore.relight import shading as shading_module
from pcore.relight.lamps import ENCODING, Light, sphere
from pcore.relight.shading import LARGEST_GAIN, Shading, spacing_of

UP = torch.tensor([[0.0, 0.0, 1.0]])


def turn(angle: float) -> torch.Tensor:
    """About x, z towards -y."""
    cos, sin = math.cos(angle), math.sin(angle)
    return torch.tensor([[1.0, 0, 0], [0, cos, -sin], [0, sin, cos]])


def frames_of(maps: torch.Tensor, rest: torch.Tensor) -> LocalMaps:
    """Frames of points (N, 3) that were moved by linear maps (N, 3, 3)."""
    return LocalMaps(rest=rest, to_rest=torch.linalg.inv(maps))


@pytest.fixture
def each_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """No point hides another."""
    monkeypatch.setattr(shading_module, "spacing_of", lambda _: 0.0)


def gains_of(light: Light, normals: torch.Tensor, maps: torch.Tensor) -> torch.Tensor:
    """Gains of points far from one another, each moved by a linear map of its own."""
    positions = 100.0 * torch.arange(len(maps))[:, None] * torch.tensor([[1.0, 0.3, 0.1]])
    return changed(shading_of(light, normals, positions), frames_of(maps, positions), positions)


def changed(
    shading: Shading, frames: LocalMaps, moved: torch.Tensor, *, world: float = 1.0
) -> torch.Tensor:
    """The factors of a deformed surface."""
    gains = shading.skin(frames, moved, world=world).gains
    assert gains is not None
    return gains


def shading_of(
    light: Light, normals: torch.Tensor, positions: torch.Tensor, brightness: float = 0.0
) -> Shading:
    """Black points, which shine on nothing, unless asked otherwise."""
    bright = torch.full((len(positions),), brightness)
    return Shading(light=light, normals=normals, positions=positions, brightness=bright, lift=0.0)


def far(directions: torch.Tensor, radiance: torch.Tensor) -> Light:
    still = torch.zeros(len(directions))
    return Light(directions=directions, radiance=radiance, nearness=still, center=torch.zeros(3))


def even(radiance: float = 1.0) -> Light:
    return far(sphere(400), torch.full((400,), radiance))


def lamp(direction: torch.Tensor, share: float = 0.5) -> Light:
    """All directions the same, and one more as bright as `share` of everything."""
    directions = torch.cat([sphere(400), direction.reshape(1, 3)])
    radiance = torch.cat([torch.ones(400), torch.tensor([share * 400])])
    return far(directions, radiance)


@pytest.mark.usefixtures("each_alone")
def test_gains_are_the_ratio_of_light_as_photos_store_it() -> None:
    light = lamp(UP[0])
    maps = torch.stack([torch.eye(3), turn(math.radians(60)), turn(math.radians(-120))])
    after = light.irradiance(maps @ UP[0])
    expected = (after / after[0]).pow(1 / ENCODING)
    torch.testing.assert_close(gains_of(light, UP.expand(3, 3), maps), expected)
    assert expected[2] < expected[1] < expected[0] == 1


@pytest.mark.usefixtures("each_alone")
def test_a_normal_follows_the_transposed_inverse() -> None:
    """A plane that faces (1, 0, 1) and is stretched along x faces more along z."""
    normal = torch.tensor([[1.0, 0.0, 1.0]]) / math.sqrt(2)
    stretched = torch.tensor([[0.5, 0.0, 1.0]]) / math.sqrt(1.25)
    light = lamp(UP[0])
    found = gains_of(light, normal, torch.diag(torch.tensor([2.0, 1.0, 1.0]))[None])
    expected = light.irradiance(stretched) / light.irradiance(normal)
    torch.testing.assert_close(found, expected.pow(1 / ENCODING))


@pytest.mark.usefixtures("each_alone")
def test_no_turn_matters_in_the_same_light_from_everywhere() -> None:
    normals = torch.nn.functional.normalize(torch.randn(20, 3), dim=1)
    maps = torch.stack([turn(angle) for angle in torch.linspace(0.1, 3, 20).tolist()])
    found = gains_of(even(), normals, maps)
    torch.testing.assert_close(found, torch.ones(20), rtol=0, atol=0.02)


@pytest.mark.usefixtures("each_alone")
def test_points_without_a_normal_stay_and_gains_are_bounded() -> None:
    light = far(UP, torch.ones(1))
    normals = torch.cat([UP, -UP, torch.zeros(1, 3)])
    found = gains_of(light, normals, turn(math.pi).expand(3, 3, 3))
    assert found.tolist() == pytest.approx([1 / LARGEST_GAIN, LARGEST_GAIN, 1.0])


def ball(count: int = 2000) -> torch.Tensor:
    return sphere(count)


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_growth_and_moves_change_no_light(scale: float) -> None:
    """With shadows and all: the inside of a half-open shell shades itself as before."""
    points = ball()[ball()[:, 2] < 0.5]
    shading = shading_of(lamp(UP[0]), -points, points)
    frames = LocalMaps(rest=points, to_rest=torch.eye(3).expand(len(points), 3, 3) / scale)
    for shift in (torch.zeros(3), torch.tensor([8.0, -4.0, 2.0])):
        found = changed(shading, frames, scale * points + shift)
        # Rounding puts a point into the next cell of a shadow map now and then.
        assert float((found - 1).abs().max()) < 0.02
        assert float((found - 1).abs().mean()) < 1e-3


def test_the_surface_lies_above_the_points_and_moves_with_them() -> None:
    """Along the normal at rest; an edit carries it along as it does everything near a point."""
    points = ball(300)
    shading = replace(shading_of(even(), points, points), lift=0.1)
    maps = torch.diag(torch.tensor([2.0, 1.0, 0.5])) @ turn(0.4)
    moved = points @ maps.T + torch.tensor([3.0, 0.0, -1.0])
    found = shading.skin(frames_of(maps.expand(300, 3, 3), points), moved)
    torch.testing.assert_close(found.places, moved + 0.1 * points @ maps.T)
    turned = torch.nn.functional.normalize(points @ torch.linalg.inv(maps), dim=1)
    torch.testing.assert_close(found.normals, turned)
    # The mean of the axes' factors, 2, 1 and 1/2, is 1.
    assert found.spacing == pytest.approx(spacing_of(points))
    torch.testing.assert_close(shading.rest.places, 1.1 * points)
    assert torch.equal(shading.rest.normals, points)
    assert torch.equal(shading.rest.beside, found.beside)
    assert shading.rest.spacing == spacing_of(points)
    assert shading.rest.deep
    assert shading.rest.gains is None, "where nothing moved the light is that of the photos"


def test_pieces_beside_a_point_are_those_of_the_rest_state_with_a_normal() -> None:
    points, normals = ball(300), ball(300).clone()
    normals[::3] = 0
    shading = shading_of(even(), normals, points)
    # Turned inside out, so that others are near.
    frames = frames_of(turn(1.0).expand(300, 3, 3), points)
    beside = shading.skin(frames, points.flip(0)).beside
    known = torch.nonzero(shading.known).squeeze(1)
    expected = known[torch.cdist(points, points[known]).argsort(dim=1)[:, :16]]
    assert torch.equal(beside.sort(dim=1).values, expected.sort(dim=1).values)
    few = shading_of(even(), normals * (torch.arange(300) < 5)[:, None], points)
    assert set(few.skin(frames, points).beside.flatten().tolist()) == {1, 2, 4}
    none = shading_of(even(), torch.zeros(300, 3), points)
    assert none.skin(frames, points).beside.shape == (300, 0)
    assert torch.equal(changed(none, frames, points), torch.ones(300))


def test_turning_in_the_same_light_from_everywhere_hardly_matters_with_shadows() -> None:
    """A bowl: what one of its sides hides of the sky another hid before."""
    points = ball()[ball()[:, 2] < 0.3]
    inside = -points
    shading = shading_of(even(), inside, points)
    back = turn(0.7).T
    frames = frames_of(back.T.expand(len(points), 3, 3), points)
    found = changed(shading, frames, points @ back)
    assert float(found.log().abs().mean()) < 0.01
    assert float(found.log().abs().max()) < 0.06


STEPS = torch.arange(-20, 20) * 0.05 + 0.025
GRID = torch.cartesian_prod(STEPS, STEPS)
PLATE = torch.cat([GRID, torch.zeros(len(GRID), 1)], dim=1)
INSIDE = (GRID.abs() < 0.8).all(dim=1) & (GRID[:, 0].abs() > 0.2)


@pytest.mark.parametrize("brightness", [0.2, 0.5])
def test_what_an_edit_uncovers_becomes_brighter_and_what_it_covers_darker(
    brightness: float,
) -> None:
    """A plate in the light of one lamp above; a lid over one half of it moves to the other.

    Below the lid the plate sees the lid in place of the lamp.
    """
    lid = PLATE[GRID[:, 0] < 0] + torch.tensor([0.0, 0.0, 0.8])
    points = torch.cat([PLATE, lid])
    shading = shading_of(far(UP, torch.ones(1)), UP.expand(len(points), 3), points, brightness)
    moved = points.clone()
    moved[len(PLATE) :, 0] += 1.0
    frames = LocalMaps(rest=points, to_rest=torch.eye(3).expand(len(points), 3, 3))
    found = changed(shading, frames, moved)
    left, right = INSIDE & (GRID[:, 0] < 0), INSIDE & (GRID[:, 0] > 0)
    brighter = (1 / brightness) ** (1 / ENCODING)
    torch.testing.assert_close(found[: len(PLATE)][left], torch.full((int(left.sum()),), brighter))
    torch.testing.assert_close(
        found[: len(PLATE)][right], torch.full((int(right.sum()),), 1 / brighter)
    )
    torch.testing.assert_close(found[len(PLATE) :], torch.ones(len(lid)))


def test_what_hides_light_is_lit_anew_itself() -> None:
    """A lid over a plate gets a roof: it becomes darker, and so does what it shines on."""
    lid = PLATE + torch.tensor([0.0, 0.0, 0.8])
    roof = PLATE + torch.tensor([5.0, 0.0, 1.6])
    points = torch.cat([PLATE, lid, roof])
    shading = shading_of(far(UP, torch.ones(1)), UP.expand(len(points), 3), points, 0.6)
    moved = points.clone()
    moved[2 * len(PLATE) :, 0] -= 5.0
    frames = LocalMaps(rest=points, to_rest=torch.eye(3).expand(len(points), 3, 3))
    found = changed(shading, frames, moved).reshape(3, len(PLATE))[:, INSIDE]
    darker = 0.6 ** (1 / ENCODING)
    torch.testing.assert_close(found[0], torch.full_like(found[0], darker))
    torch.testing.assert_close(found[1], torch.full_like(found[1], darker))
    torch.testing.assert_close(found[2], torch.ones_like(found[2]))


@pytest.mark.usefixtures("each_alone")
def test_what_comes_nearer_to_a_lamp_becomes_brighter_unless_the_lamp_moves_along() -> None:
    points = ball(300)
    light = Light(
        directions=UP,
        radiance=torch.ones(1),
        nearness=torch.tensor([0.2]),
        center=torch.zeros(3),
    )
    shading = shading_of(light, points, points)
    frames = LocalMaps(rest=points, to_rest=torch.eye(3).expand(300, 3, 3) / 2)
    lit = points[:, 2] > 0.6
    found = changed(shading, frames, 2 * points)
    expected = (light.falling(2 * points, points) / light.falling(points, points))[:, 0]
    torch.testing.assert_close(found[lit], expected[lit].pow(1 / ENCODING))
    assert float(found.max()) > 1.25
    torch.testing.assert_close(changed(shading, frames, 2 * points, world=2.0), torch.ones(300))


def test_a_point_alone_is_lit_by_its_normal() -> None:
    shading = shading_of(lamp(UP[0]), UP, torch.zeros(1, 3))
    turned = turn(math.pi / 2)[None]
    found = changed(shading, frames_of(turned, torch.zeros(1, 3)), torch.zeros(1, 3))
    after, before = lamp(UP[0]).irradiance(torch.cat([turned[0] @ UP[0][:, None], UP.T], dim=1).T)
    torch.testing.assert_close(found[0], (after / before).pow(1 / ENCODING))


def test_a_shading_is_checked() -> None:
    one = torch.ones(1)
    for normals, positions, bright in (
        (torch.zeros(4), torch.zeros(4), one),
        (UP, torch.zeros(2, 3), one),
        (UP, UP, torch.ones(2)),
    ):
        with pytest.raises(InputError, match=r"positions \(N, 3\) and brightness \(N,\), got"):
            Shading(light=even(), normals=normals, positions=positions, brightness=bright, lift=0.0)
    with pytest.raises(InputError, match=r"expected float32 on the CPU, got torch.float64"):
        Shading(light=even(), normals=UP, positions=UP.double(), brightness=one, lift=0.0)
    for bad in (-one, math.nan * one, math.inf * one):
        with pytest.raises(InputError, match="finite brightness of 0 or more"):
            Shading(light=even(), normals=UP, positions=UP, brightness=bad, lift=0.0)
    for normals in (0.3 * UP, math.nan * UP):
        with pytest.raises(InputError, match="normals of unit length, or zero where not known"):
            Shading(light=even(), normals=normals, positions=UP, brightness=one, lift=0.0)
    for lift in (math.nan, math.inf):
        with pytest.raises(InputError, match=f"a finite lift, got {lift}"):
            replace(shading_of(even(), UP, UP), lift=lift)
    for world in (0.0, -1.0, math.nan):
        with pytest.raises(InputError, match=f"world factor above 0, got {world}"):
            shading_of(even(), UP, UP).skin(frames_of(torch.eye(3)[None], UP), UP, world=world)
    shading, still = shading_of(even(), UP, UP), torch.eye(3)
    for frames, moved in (
        (frames_of(still.expand(2, 3, 3), torch.zeros(2, 3)), torch.zeros(2, 3)),
        (frames_of(still[None], UP), torch.zeros(2, 3)),
    ):
        with pytest.raises(InputError, match=r"of its 1 points.*got \d and 2; .*`pcore light RUN`"):
            shading.skin(frames, moved)
    with pytest.raises(
        InputError, match="the points that the light was estimated with, got others"
    ):
        shading.skin(frames_of(still[None], UP + 1), UP)
    flat = LocalMaps(rest=UP, to_rest=torch.diag(torch.tensor([1.0, 0.0, 1.0]))[None])
    for bad_frames in (flat, replace(flat, to_rest=1e-40 * torch.eye(3)[None])):
        with pytest.raises(InputError, match="local maps with an inverse, got 1 of 1 without"):
            replace(shading, lift=0.1).skin(bad_frames, UP)
    with pytest.raises(InputError, match="finite points, got NaN or infinity in 1 of 1"):
        shading.skin(frames_of(still[None], UP), UP * math.nan)


def test_a_cloud_keeps_its_skin_until_it_moves() -> None:
    cloud = PointCloud(
        positions=torch.zeros(2, 3), features=torch.zeros(2, 4), influence=torch.ones(2)
    )
    skin = Surfels(
        places=torch.zeros(2, 3),
        normals=UP.expand(2, 3),
        beside=torch.zeros(2, 1, dtype=torch.int64),
        spacing=0.1,
        gains=torch.tensor([2.0, 0.5]),
    )
    whole = cloud.covered(skin)
    assert cloud.skin is None
    for same in (whole, whole.detached(), whole.to("cpu")):
        assert same.skin is not None
        assert same.skin.gains is not None
        assert same.skin.gains.tolist() == [2.0, 0.5]
    away = whole.to("meta").skin
    assert away is not None
    assert {one.device.type for one in (away.places, away.normals, away.beside)} == {"meta"}
    assert replace(skin, gains=None).to("meta").gains is None
    none = Surfels(
        places=torch.zeros(0, 3),
        normals=torch.zeros(0, 3),
        beside=torch.zeros(0, 1, dtype=torch.int64),
        spacing=0.0,
    )
    empty = PointCloud(
        positions=torch.zeros(0, 3), features=torch.zeros(0, 4), influence=torch.ones(0), skin=none
    )
    left = empty.to("meta").skin
    assert left is not None
    assert left.places.device.type == "meta"
    wild = torch.full((2, 3), math.nan)
    for odd in (replace(skin, places=wild), replace(skin, normals=wild)):
        assert odd.finite.tolist() == [False, False]
    assert skin.finite.tolist() == [True, True]
    assert whole.moved(torch.ones(2, 3)).skin is None, "it belongs to where the points were"
    with pytest.raises(InputError, match="a skin over its 3 points, got 2"):
        PointCloud(
            positions=torch.zeros(3, 3),
            features=torch.zeros(3, 4),
            influence=torch.ones(3),
            skin=skin,
        )
    bad: dict[str, torch.Tensor]
    for bad in ({"gains": torch.ones(3)}, {"normals": torch.ones(3, 2)}, {"beside": torch.ones(2)}):
        with pytest.raises(InputError, match=r"neighbours \(N, K\) and gains \(N,\), got"):
            replace(skin, **bad)  # type: ignore[arg-type]
