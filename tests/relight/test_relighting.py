"""How points change when an edit turns and moves them in a light that stands still."""

import math
from dataclasses import dataclass, replace

import pytest
import torch

from pcore.errors import InputError
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.surfels import Surfels
from pcore.relight.lamps import Light, sphere
from pcore.relight.relight_config import DEFAULT
from pcore.relight.relighting import Relighting

ENCODING, LARGEST_GAIN = DEFAULT.encoding, DEFAULT.largest_gain
UP = torch.tensor([[0.0, 0.0, 1.0]])


def turn(angle: float) -> torch.Tensor:
    """About x, z towards -y."""
    cos, sin = math.cos(angle), math.sin(angle)
    return torch.tensor([[1.0, 0, 0], [0, cos, -sin], [0, sin, cos]])


@dataclass(frozen=True)
class Lit:
    """Canonical points with surfels, and the light on them."""

    relighting: Relighting
    surfels: Surfels

    def moved(self, maps: torch.Tensor, places: torch.Tensor) -> PosedCloud:
        """The points at places (N, 3), around which space was moved by linear maps (N, 3, 3)."""
        rest = self.relighting.positions
        cloud = PointCloud(
            positions=rest, features=torch.zeros(len(rest), 1), influence=torch.ones(len(rest))
        )
        local_maps = LocalMaps(to_rest=torch.linalg.inv(maps))
        surfels = self.surfels.moved(places, local_maps)
        return PosedCloud(cloud=cloud, positions=places, local_maps=local_maps, surfels=surfels)

    def gains(
        self, maps: torch.Tensor, places: torch.Tensor, *, world: float = 1.0
    ) -> torch.Tensor:
        """The factors of the posed surface."""
        return self.relighting.gains(self.moved(maps, places), world=world)


def still(count: int, scale: float = 1.0) -> torch.Tensor:
    return scale * torch.eye(3).repeat(count, 1, 1)


def gains_of(light: Light, normals: torch.Tensor, maps: torch.Tensor) -> torch.Tensor:
    """Gains of points far from one another, each moved by a linear map of its own."""
    positions = 100.0 * torch.arange(len(maps))[:, None] * torch.tensor([[1.0, 0.3, 0.1]])
    return lit(light, normals, positions, alone=True).gains(maps, positions)


def lit(
    light: Light,
    normals: torch.Tensor,
    positions: torch.Tensor,
    brightness: float = 0.0,
    *,
    height: float = 0.0,
    alone: bool = False,
) -> Lit:
    """Black points, which shine on nothing, unless asked otherwise; alone, they hide nothing."""
    surfels = Surfels.at_rest(positions, normals, torch.full((len(positions),), height))
    surfels = replace(surfels, spacing=0.0) if alone else surfels
    bright = torch.full((len(positions),), brightness)
    return Lit(Relighting.of(light, positions, surfels, bright), surfels)


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


def test_gains_are_the_ratio_of_light_as_photos_store_it() -> None:
    light = lamp(UP[0])
    maps = torch.stack([torch.eye(3), turn(math.radians(60)), turn(math.radians(-120))])
    after = light.irradiance(maps @ UP[0])
    expected = (after / after[0]).pow(1 / ENCODING)
    torch.testing.assert_close(gains_of(light, UP.expand(3, 3), maps), expected)
    assert expected[2] < expected[1] < expected[0] == 1


def test_a_normal_follows_the_transposed_inverse() -> None:
    """A plane that faces (1, 0, 1) and is stretched along x faces more along z."""
    normal = torch.tensor([[1.0, 0.0, 1.0]]) / math.sqrt(2)
    stretched = torch.tensor([[0.5, 0.0, 1.0]]) / math.sqrt(1.25)
    light = lamp(UP[0])
    found = gains_of(light, normal, torch.diag(torch.tensor([2.0, 1.0, 1.0]))[None])
    expected = light.irradiance(stretched) / light.irradiance(normal)
    torch.testing.assert_close(found, expected.pow(1 / ENCODING))


def test_no_turn_matters_in_the_same_light_from_everywhere() -> None:
    normals = torch.nn.functional.normalize(torch.randn(20, 3), dim=1)
    maps = torch.stack([turn(angle) for angle in torch.linspace(0.1, 3, 20).tolist()])
    found = gains_of(even(), normals, maps)
    torch.testing.assert_close(found, torch.ones(20), rtol=0, atol=0.02)


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
    shell = lit(lamp(UP[0]), -points, points)
    for shift in (torch.zeros(3), torch.tensor([8.0, -4.0, 2.0])):
        found = shell.gains(still(len(points), scale), scale * points + shift)
        # Rounding puts a point into the next cell of a shadow map now and then.
        assert float((found - 1).abs().max()) < 0.02
        assert float((found - 1).abs().mean()) < 1e-3


def test_turning_in_the_same_light_from_everywhere_hardly_matters_with_shadows() -> None:
    """A bowl: what one of its sides hides of the sky another hid before."""
    points = ball()[ball()[:, 2] < 0.3]
    inside = -points
    back = turn(0.7).T
    maps = back.T.expand(len(points), 3, 3)
    found = lit(even(), inside, points).gains(maps, points @ back)
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
    plates = lit(far(UP, torch.ones(1)), UP.expand(len(points), 3), points, brightness)
    moved = points.clone()
    moved[len(PLATE) :, 0] += 1.0
    found = plates.gains(still(len(points)), moved)
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
    plates = lit(far(UP, torch.ones(1)), UP.expand(len(points), 3), points, 0.6)
    moved = points.clone()
    moved[2 * len(PLATE) :, 0] -= 5.0
    found = plates.gains(still(len(points)), moved).reshape(3, len(PLATE))[:, INSIDE]
    darker = 0.6 ** (1 / ENCODING)
    torch.testing.assert_close(found[0], torch.full_like(found[0], darker))
    torch.testing.assert_close(found[1], torch.full_like(found[1], darker))
    torch.testing.assert_close(found[2], torch.ones_like(found[2]))


def test_what_comes_nearer_to_a_lamp_becomes_brighter_unless_the_lamp_moves_along() -> None:
    points = ball(300)
    light = Light(
        directions=UP,
        radiance=torch.ones(1),
        nearness=torch.tensor([0.2]),
        center=torch.zeros(3),
    )
    near = lit(light, points, points, alone=True)
    top = points[:, 2] > 0.6
    found = near.gains(still(300, 2.0), 2 * points)
    expected = (light.falling(2 * points, points) / light.falling(points, points))[:, 0]
    torch.testing.assert_close(found[top], expected[top].pow(1 / ENCODING))
    assert float(found.max()) > 1.25
    along = near.gains(still(300, 2.0), 2 * points, world=2.0)
    torch.testing.assert_close(along, torch.ones(300))


def test_a_point_alone_is_lit_by_its_normal() -> None:
    turned = turn(math.pi / 2)[None]
    found = lit(lamp(UP[0]), UP, torch.zeros(1, 3)).gains(turned, torch.zeros(1, 3))
    after, before = lamp(UP[0]).irradiance(torch.cat([turned[0] @ UP[0][:, None], UP.T], dim=1).T)
    torch.testing.assert_close(found[0], (after / before).pow(1 / ENCODING))


def test_a_light_is_checked() -> None:
    one, light = torch.ones(1), even()

    def made(**changes: torch.Tensor) -> Relighting:
        parts = {"positions": UP, "brightness": one, "received": one}
        return Relighting(light=light, **{**parts, **changes})

    for changes in (
        {"positions": torch.zeros(4)},
        {"brightness": torch.ones(2)},
        {"received": torch.ones(2)},
    ):
        with pytest.raises(InputError, match=r"brightness \(N,\) and received light \(N,\), got"):
            made(**changes)
    with pytest.raises(InputError, match=r"expected float32 on the CPU, got torch.float64"):
        made(positions=UP.double())
    for bad in (-one, math.nan * one, math.inf * one):
        with pytest.raises(InputError, match="finite brightness of 0 or more"):
            made(brightness=bad)
    for bad in (0 * one, math.nan * one):
        with pytest.raises(InputError, match="finite light above 0"):
            made(received=bad)


def test_poses_that_light_cannot_fall_on() -> None:
    plate = lit(even(), UP, UP)
    posed = plate.moved(still(1), UP)
    for world in (0.0, -1.0, math.nan):
        with pytest.raises(InputError, match=f"world factor above 0, got {world}"):
            plate.relighting.gains(posed, world=world)
    with pytest.raises(InputError, match=r"the 1 canonical points .* others; .*`pcore light RUN`"):
        plate.relighting.gains(posed.each(lambda one: one + 1))
    with pytest.raises(InputError, match="points with surfels, got none"):
        plate.relighting.gains(replace(posed, surfels=None))
    with pytest.raises(InputError, match="finite points, got NaN or infinity in 1 of 1"):
        plate.relighting.gains(replace(posed, positions=UP * math.nan))
    followed = replace(posed, positions=UP.clone().requires_grad_())
    with pytest.raises(InputError, match="a gradient is asked for, and shadows have none"):
        plate.relighting.gains(followed)
    with torch.no_grad():
        assert plate.relighting.gains(followed).tolist() == pytest.approx([1.0])
