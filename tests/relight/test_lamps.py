"""A light that stands in the world: what its lamps give to surfaces, near ones and far ones."""

import math

import pytest
import torch

from pcore.errors import InputError
from pcore.relight.lamps import Light, sphere

UP = torch.tensor([[0.0, 0.0, 1.0]])


def far(directions: torch.Tensor, radiance: torch.Tensor) -> Light:
    still = torch.zeros(len(directions))
    return Light(directions=directions, radiance=radiance, nearness=still, center=torch.zeros(3))


def tilted(degrees: float) -> torch.Tensor:
    angle = math.radians(degrees)
    return torch.tensor([[0.0, math.sin(angle), math.cos(angle)]])


def test_directions_are_even() -> None:
    directions = sphere(192)
    torch.testing.assert_close(directions.norm(dim=1), torch.ones(192))
    assert float(directions.mean(dim=0).norm()) < 1e-3
    closest = (directions @ directions.T - 2 * torch.eye(192)).amax(dim=1)
    assert float(closest.max() - closest.min()) < 0.02


def test_the_same_light_from_everywhere_gives_every_surface_one() -> None:
    normals = torch.nn.functional.normalize(torch.randn(50, 3), dim=1)
    even = far(sphere(400), torch.ones(400))
    torch.testing.assert_close(even.irradiance(normals), torch.ones(50), rtol=0, atol=0.02)


def test_one_far_lamp_follows_the_cosine_wherever_the_surface_is() -> None:
    light = far(UP, torch.tensor([3.0]))
    normals = torch.cat([UP, tilted(60), -UP])
    expected = 4 * 3.0 * torch.tensor([1.0, 0.5, 0.0])
    torch.testing.assert_close(light.irradiance(normals), expected)
    for place in (torch.zeros(3, 3), torch.tensor([[5.0, -2.0, 9.0]]).expand(3, 3)):
        torch.testing.assert_close(light.falling(place, normals)[:, 0], expected)


@pytest.mark.parametrize("distance", [2.0, 5.0])
def test_a_near_lamp_follows_cosines_and_the_square_of_the_distance(distance: float) -> None:
    """Word for word, for a lamp above a centre that is not the origin."""
    center = torch.tensor([1.0, 2.0, 3.0])
    light = Light(
        directions=UP,
        radiance=torch.tensor([2.0]),
        nearness=torch.tensor([1 / distance]),
        center=center,
    )
    lamp = center + distance * UP[0]
    normals = torch.cat([UP, tilted(40), tilted(-70)])
    for offset in (torch.zeros(3), torch.tensor([0.4, -0.3, 0.5]), torch.tensor([0.0, 0.9, -1.0])):
        place = center + offset
        towards = lamp - place
        length = float(towards.norm())
        received = (normals @ towards / length).clamp_min(0)
        sent = float(UP[0] @ towards) / length
        expected = 4 * 2.0 * received * sent * (distance / length) ** 2
        found = light.falling(place.expand(3, 3), normals)[:, 0]
        torch.testing.assert_close(found, expected)


def test_irradiance_is_that_at_the_centre() -> None:
    center, normals = torch.tensor([1.0, 2.0, 3.0]), torch.cat([UP, tilted(40)])
    light = Light(
        directions=sphere(50),
        radiance=torch.rand(50),
        nearness=torch.rand(50) / 3,
        center=center,
    )
    expected = light.falling(center.expand(2, 3), normals).sum(dim=1)
    torch.testing.assert_close(light.irradiance(normals), expected)
    torch.testing.assert_close(light.irradiance(normals.double()), expected.double())
    torch.testing.assert_close(
        light.falling(center.double().expand(2, 3), normals).sum(dim=1), expected
    )


def test_a_lamp_that_goes_away_becomes_a_far_one() -> None:
    normals, places = torch.cat([UP, tilted(50)]), torch.tensor([[0.5, 0.2, 0.4], [0.0, -1.0, 0.3]])
    light = Light(
        directions=UP,
        radiance=torch.ones(1),
        nearness=torch.tensor([1e-6]),
        center=torch.zeros(3),
    )
    expected = far(UP, torch.ones(1)).falling(places, normals)
    torch.testing.assert_close(light.falling(places, normals), expected, rtol=1e-4, atol=1e-4)


def test_nothing_behind_a_lamp_is_lit_and_nothing_beside_it_is_blinding() -> None:
    light = Light(
        directions=UP, radiance=torch.ones(1), nearness=torch.ones(1), center=torch.zeros(3)
    )
    places = torch.tensor([[0.0, 0.0, 1.5], [0.0, 0.0, 1.0 - 1e-4]])
    found = light.falling(places, torch.cat([-UP, UP]))[:, 0]
    assert found[0] == 0
    assert 0 < float(found[1]) < 4 * 0.2**-4


def test_a_scaled_world_is_lit_the_same() -> None:
    light = Light(
        directions=sphere(20),
        radiance=torch.rand(20),
        nearness=0.3 * torch.rand(20),
        center=torch.tensor([0.1, -0.2, 0.3]),
    )
    places, normals = torch.randn(30, 3), torch.nn.functional.normalize(torch.randn(30, 3), dim=1)
    for factor in (0.5, 2.0):
        found = light.scaled(factor).falling(factor * places, normals)
        torch.testing.assert_close(found, light.falling(places, normals))
    assert not torch.allclose(light.falling(2 * places, normals), light.falling(places, normals))


def test_a_light_is_checked() -> None:
    one, center = torch.ones(1), torch.zeros(3)
    for radiance, nearness in ((torch.ones(2), one), (one, torch.ones(2))):
        with pytest.raises(InputError, match=r"radiance \(D,\) and nearness \(D,\), got \(1, 3\)"):
            Light(directions=UP, radiance=radiance, nearness=nearness, center=center)
    for radiance in (-one, 0 * one, math.nan * one, math.inf * one):
        with pytest.raises(InputError, match="radiance of 0 or more, and some of it above 0"):
            Light(directions=UP, radiance=radiance, nearness=one, center=center)
    for nearness in (-one, math.nan * one, math.inf * one):
        with pytest.raises(InputError, match=r"nearness of 0 \(far away\) or more, and finite"):
            Light(directions=UP, radiance=one, nearness=nearness, center=center)
    for directions in (2 * UP, math.nan * UP, torch.zeros(1, 3)):
        with pytest.raises(InputError, match="directions of unit length"):
            Light(directions=directions, radiance=one, nearness=one, center=center)
    with pytest.raises(InputError, match=r"got \(\), \(1,\) and \(1,\)"):
        Light(directions=torch.tensor(1.0), radiance=one, nearness=one, center=center)
    with pytest.raises(InputError, match=r"float32 throughout, got torch.float32, torch.int64"):
        Light(directions=UP, radiance=one.long(), nearness=one, center=center)
    with pytest.raises(InputError, match="a finite center"):
        Light(directions=UP, radiance=one, nearness=one, center=math.nan * center)
    with pytest.raises(InputError, match=r"center \(3,\), got \(2,\)"):
        Light(directions=UP, radiance=one, nearness=one, center=torch.zeros(2))
