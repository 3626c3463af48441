"""The light of a scene is found from what points show, whatever their paint."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.nn import functional as F

from pcore.errors import InputError
from pcore.geometry.surfels import spacing_of
from pcore.relight import estimate as light_fit
from pcore.relight.estimate import brightness_of, fit_lamps, fit_light
from pcore.relight.lamps import Light, sphere
from pcore.relight.relight_config import DEFAULT
from pcore.relight.relighting import reaching
from pcore.relight.shadows import Shadows, shadows_of
from pcore.render.surfel_fit import Observed

ENCODING, DIRECTIONS = DEFAULT.encoding, DEFAULT.directions

PAINTS = torch.tensor([[0.1, 0.1, 0.1], [0.8, 0.8, 0.8], [0.5, 0.2, 0.1], [0.1, 0.3, 0.5]])
LAMP = F.normalize(torch.tensor([1.0, -2.0, 2.0]), dim=0)


def studio(share: float = 0.3, nearness: float = 0.0) -> Light:
    """A wide lamp among light from everywhere."""
    directions = sphere(300)
    lobe = (8 * (directions @ LAMP - 1)).exp()
    return Light(
        directions=directions,
        radiance=1 + share * 300 * lobe / lobe.sum(),
        nearness=torch.full((300,), nearness),
        center=torch.zeros(3),
    )


def painted(
    positions: torch.Tensor, normals: torch.Tensor, linear: torch.Tensor, noise: float = 0.02
) -> Observed:
    """Four paints, two of one hue, some specks, and a few points without a normal."""
    count, generator = len(positions), torch.Generator().manual_seed(3)
    paint = PAINTS[torch.randint(0, 4, (count,), generator=generator)]
    bright = 0.5 * paint.pow(ENCODING) * linear[:, None]
    bright = bright * (1 + noise * torch.randn(count, 1, generator=generator))
    colors = bright.clamp_min(0).pow(1 / ENCODING)
    colors[: count // 20] = torch.rand(count // 20, 3, generator=generator)
    known = torch.ones(count, 1)
    known[-count // 10 :] = 0
    return observed_of(normals * known, colors, torch.ones(count))


def observed_of(normals: torch.Tensor, colors: torch.Tensor, attention: torch.Tensor) -> Observed:
    heights = torch.zeros(len(normals))
    return Observed(normals=normals, colors=colors, attention=attention, heights=heights)


def ball(light: Light, count: int = 4000, noise: float = 0.02) -> tuple[Observed, torch.Tensor]:
    """A painted ball of radius 1, and its points."""
    points = F.normalize(torch.randn(count, 3, generator=torch.Generator().manual_seed(4)), dim=1)
    linear = light.falling(points, points).sum(dim=1)
    return painted(points, points, linear, noise), points


def nothing_hidden(observed: Observed) -> Shadows:
    count = len(observed.normals)
    hider = torch.arange(count, dtype=torch.int32)[:, None].repeat(1, DIRECTIONS)
    return Shadows(open=torch.ones(count, DIRECTIONS), hider=hider)


def found_from(observed: Observed, points: torch.Tensor) -> Light:
    return fit_lamps(observed, points, nothing_hidden(observed))


def shape_of(light: Light) -> torch.Tensor:
    """Log irradiance of all normals, without its mean: what gains are made of."""
    found = light.irradiance(sphere(500)).log()
    return found - found.mean()


def off(found: Light, expected: Light) -> float:
    """Share of what the light varies by that is wrong."""
    wanted = shape_of(expected)
    return float((shape_of(found) - wanted).square().mean().sqrt() / wanted.std())


@pytest.mark.parametrize("share", [0.1, 0.3, 1.0])
def test_the_light_is_found_whatever_the_paint(share: float) -> None:
    light = studio(share)
    found = found_from(*ball(light))
    assert off(found, light) < 0.12
    toward = sphere(500)[shape_of(found).argmax()]
    assert math.degrees(math.acos(float(toward @ LAMP))) < 15


@pytest.mark.parametrize("nearness", [0.0, 0.15, 0.3])
def test_how_far_away_the_lamps_are_is_found(nearness: float) -> None:
    """Of a figure of two balls: surfaces that face the same way are not lit the same."""
    light = studio(1.0, nearness)
    points = F.normalize(torch.randn(4000, 3, generator=torch.Generator().manual_seed(5)), dim=1)
    places = 0.5 * points + torch.where(torch.arange(4000) % 2 == 0, 0.5, -0.5)[:, None] * LAMP
    observed = painted(places, points, light.falling(places, points).sum(dim=1))
    found = fit_lamps(observed, places, nothing_hidden(observed))
    share = found.radiance / found.radiance.sum()
    # Drawn towards far away, where that costs next to nothing.
    assert nearness - 0.06 < float((share * found.nearness).sum()) < nearness + 0.06
    assert float(found.center.norm()) < 0.05


def test_light_off_other_surfaces_is_told_from_that_of_lamps() -> None:
    """A bowl inside which every surface shines on the others: the true light is found all the same.

    Its brightness is that of the equations themselves, solved in turns. Taken for light of lamps,
    what comes off the bowl would be a lamp below.
    """
    points = F.normalize(torch.randn(4000, 3, generator=torch.Generator().manual_seed(6)), dim=1)
    points = points[points[:, 2] < 0.2]
    directions = sphere(DIRECTIONS)
    lobe = (8 * (directions @ LAMP - 1)).exp()
    light = Light(
        directions=directions,
        radiance=0.5 + DIRECTIONS * lobe / lobe.sum(),
        nearness=torch.zeros(DIRECTIONS),
        center=torch.zeros(3),
    )
    normals = -points
    shadows = shadows_of(points, normals, directions, spacing_of(points))
    there, paint = reaching(light, points, normals, shadows), 0.6
    brightness = torch.zeros(len(points))
    for _ in range(8):
        brightness = paint * there.on(brightness)
    colors = brightness[:, None].pow(1 / ENCODING).expand(-1, 3)
    observed = observed_of(normals, colors, torch.ones(len(points)))
    told = fit_lamps(observed, points, shadows)
    untold = fit_lamps(observed, points, replace(shadows, open=torch.ones_like(shadows.open)))
    up = normals[:, 2] > 0.5
    expected = light.irradiance(normals[up]).log()

    def error(found: Light) -> float:
        gap = found.irradiance(normals[up]).log() - expected
        return float((gap - gap.mean()).std() / expected.std())

    assert error(told) < 0.3
    assert error(untold) > 1.5 * error(told)


def test_points_without_a_normal_are_not_compared() -> None:
    """Here the first half; what is left is as if only the others were there."""
    observed, points = ball(studio(1.0), noise=0.0)
    half = len(points) // 2
    normals = observed.normals.clone()
    normals[:half] = 0
    colors = observed.colors.clone()
    colors[:half] = torch.rand(half, 3)
    seen = replace(observed, normals=normals, colors=colors)
    rest = observed_of(normals[half:], colors[half:], observed.attention[half:])
    found, expected = found_from(seen, points), found_from(rest, points[half:])
    torch.testing.assert_close(shape_of(found), shape_of(expected), rtol=0, atol=0.02)


def test_a_stray_point_moves_no_lamp() -> None:
    """Points that no photo shows have no normal; the others say where the object is."""
    observed, points = ball(studio(1.0, 0.2), count=1500)
    expected = found_from(observed, points)
    with_stray = torch.cat([points, torch.tensor([[20.0, 0.0, 0.0]])])
    seen = observed_of(
        torch.cat([observed.normals, torch.zeros(1, 3)]),
        torch.cat([observed.colors, torch.ones(1, 3)]),
        torch.cat([observed.attention, torch.zeros(1)]),
    )
    found = found_from(seen, with_stray)
    for name in ("radiance", "nearness", "center"):
        torch.testing.assert_close(getattr(found, name), getattr(expected, name))


def test_pairs_that_are_near_count_three_times() -> None:
    """Of two clusters far apart, whose points are of two hues in turn."""
    points = torch.randn(400, 3, generator=torch.Generator().manual_seed(7))
    points[200:, 0] += 50.0
    colors = torch.where((torch.arange(400) % 2 == 0)[:, None], torch.tensor([0.6, 0.3, 0.2]), 0.4)
    found = light_fit._pairs(points, colors, np.random.default_rng(0), DEFAULT)
    weights, first, second = (
        one.reshape(400, 16) for one in (found.weights, found.first, found.second)
    )
    alike = first % 2 == second % 2
    torch.testing.assert_close(weights[:, :8][alike[:, :8]].unique(), torch.tensor([3.0]))
    torch.testing.assert_close(weights[:, 8:][alike[:, 8:]].unique(), torch.tensor([1.0]))
    same = first // 200 == second // 200
    assert bool(same[:, :8].all()), "64 neighbours lie in one cluster"
    assert not bool(same[:, 8:].all()), "points of one hue lie in both"


def test_points_that_hardly_any_pixel_showed_hardly_count() -> None:
    """Half of the points, at random, have colours of their own and next to no attention."""
    light = studio(1.0)
    observed, points = ball(light, noise=0.0)
    odd = torch.arange(len(points)) % 2 == 1
    colors = observed.colors.clone()
    colors[odd] = (0.3 + 0.2 * points[odd, :1]).expand(-1, 3)
    seen = replace(observed, colors=colors, attention=torch.where(odd, 1e-4, 1.0))
    assert off(found_from(seen, points), light) < 0.1
    assert off(found_from(replace(seen, attention=torch.ones(len(points))), points), light) > 0.2


def test_many_points_are_as_good_as_some() -> None:
    observed, points = ball(studio())
    expected = shape_of(found_from(observed, points))
    few = replace(DEFAULT, most_points=1500)
    found = shape_of(fit_lamps(observed, points, nothing_hidden(observed), few))
    assert not torch.equal(found, expected)
    assert float((found - expected).square().mean().sqrt()) < 0.1 * float(expected.std())


def test_sizes_and_places_of_objects_do_not_matter() -> None:
    observed, points = ball(studio(1.0, 0.2), count=1500)
    expected = found_from(observed, points)
    found = found_from(observed, 4 * points + torch.tensor([8.0, -4.0, 2.0]))
    torch.testing.assert_close(found.radiance, expected.radiance, rtol=1e-2, atol=1e-3)
    torch.testing.assert_close(4 * found.nearness, expected.nearness, rtol=0, atol=5e-3)


def test_what_no_view_saw_is_as_bright_as_what_lies_beside_it() -> None:
    points = torch.tensor([[0.0, 0, 0], [1.0, 0, 0], [1.1, 0, 0]])
    colors = torch.tensor([[0.2, 0.4, 0.6], [0.9, 0.9, 0.9], [0.0, 0.0, 0.0]])
    seen = observed_of(torch.zeros(3, 3), colors, torch.tensor([1.0, 2.0, 0.0]))
    expected = [float(colors[0].pow(ENCODING).mean()), 0.9**ENCODING, 0.9**ENCODING]
    assert brightness_of(seen, points).tolist() == pytest.approx(expected)
    blind = replace(seen, attention=torch.zeros(3))
    assert brightness_of(blind, points)[2] == 0


def test_a_light_is_fitted_with_what_points_hide() -> None:
    """And keeps the points that it belongs to."""
    seen, points = ball(studio(), count=1500)
    # Turned inside out a ball hides all lamps from itself.
    seen = replace(seen, normals=-seen.normals)
    found = fit_light(seen, points)
    assert torch.equal(found.positions, points)
    assert torch.equal(found.brightness, brightness_of(seen, points))
    assert found.config == DEFAULT
    shadows = shadows_of(points, seen.normals, sphere(DIRECTIONS), spacing_of(points))
    assert float(shadows.open.min()) < 0.5, "half of a ball is hidden from any direction"
    assert torch.equal(found.light.radiance, fit_lamps(seen, points, shadows).radiance)
    assert not torch.equal(found.light.radiance, found_from(seen, points).radiance)


def test_the_same_light_from_everywhere_is_found_even() -> None:
    even = replace(studio(), radiance=torch.ones(300))
    assert float(shape_of(found_from(*ball(even))).std()) < 0.05


def test_it_is_the_same_every_time_and_the_seed_outside_stays() -> None:
    observed, points = ball(studio(), count=1000)
    before = torch.get_rng_state()
    with torch.no_grad():
        first, second = found_from(observed, points), found_from(observed, points)
    assert torch.equal(first.radiance, second.radiance)
    assert torch.equal(first.nearness, second.nearness)
    assert torch.equal(before, torch.get_rng_state())


def test_too_few_normals_are_an_error() -> None:
    observed, points = ball(studio(), count=400)
    few = replace(observed, normals=observed.normals * (torch.arange(400) < 49)[:, None])
    with pytest.raises(InputError, match=r"at least 50 points with a normal .* got 49 of 400"):
        found_from(few, points)


def test_shadows_of_other_directions_are_an_error() -> None:
    observed, points = ball(studio(), count=400)
    shadows = shadows_of(points, observed.normals, sphere(20), 0.1)
    with pytest.raises(InputError, match=r"expected shadows \(400, 192\), got \(400, 20\)"):
        fit_lamps(observed, points, shadows)


def test_one_colour_alone_is_enough() -> None:
    normal, light = sphere(600), studio()
    colors = (0.3 * light.irradiance(normal)[:, None]).pow(1 / ENCODING).expand(600, 3)
    observed = observed_of(normal, colors, torch.ones(600))
    assert off(found_from(observed, normal), light) < 0.12


def test_black_points_and_no_points_at_all() -> None:
    """Photos of nothing say nothing, in numbers that can be used."""
    observed, points = ball(studio(), count=400)
    found = found_from(replace(observed, colors=torch.zeros(400, 3)), points)
    assert bool(torch.isfinite(found.radiance).all())
    nothing = observed_of(torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(0))
    with pytest.raises(InputError, match="got 0 of 0"):
        found_from(nothing, torch.zeros(0, 3))
