"""The light of a scene is found from what points show, whatever their paint."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch.nn import functional as F

from pcore.errors import InputError
from pcore.geometry.light import ENCODING, Light, irradiance_of, reaching
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.visibility import cloud_spacing
from pcore.training import light_fit
from pcore.training.light_fit import DIRECTIONS, Observed, fit_light, fit_shading, sphere

PAINTS = torch.tensor([[0.1, 0.1, 0.1], [0.8, 0.8, 0.8], [0.5, 0.2, 0.1], [0.1, 0.3, 0.5]])
LAMP = F.normalize(torch.tensor([1.0, -2.0, 2.0]), dim=0)


def studio(share: float = 0.3) -> Light:
    """A wide lamp among light from everywhere."""
    directions = sphere(300)
    lobe = (8 * (directions @ LAMP - 1)).exp()
    return Light(directions=directions, radiance=1 + share * 300 * lobe / lobe.sum())


def painted_ball(light: Light, count: int = 4000, noise: float = 0.02) -> Observed:
    """Four paints, two of one hue, some specks, and a few points without a normal."""
    generator = torch.Generator().manual_seed(3)
    normal = F.normalize(torch.randn(count, 3, generator=generator), dim=1)
    paint = PAINTS[torch.randint(0, 4, (count,), generator=generator)]
    linear = 0.5 * paint.pow(ENCODING) * light.irradiance(normal)[:, None]
    linear = linear * (1 + noise * torch.randn(count, 1, generator=generator))
    colors = linear.clamp_min(0).pow(1 / ENCODING)
    colors[: count // 20] = torch.rand(count // 20, 3, generator=generator)
    normal[-count // 10 :] = 0
    return Observed(normals=normal, colors=colors, attention=torch.ones(count))


def shape_of(light: Light) -> torch.Tensor:
    """Log irradiance of all normals, without its mean: what gains are made of."""
    found = light.irradiance(sphere(500)).log()
    return found - found.mean()


@pytest.mark.parametrize("share", [0.1, 0.3, 1.0])
def test_the_light_is_found_whatever_the_paint(share: float) -> None:
    light = studio(share)
    found, expected = shape_of(fit_light(painted_ball(light))), shape_of(light)
    assert float((found - expected).square().mean().sqrt()) < 0.25 * float(expected.std())
    toward = sphere(500)[found.argmax()]
    assert math.degrees(math.acos(float(toward @ LAMP))) < 15


def test_what_is_hidden_from_points_is_not_taken_for_darkness() -> None:
    """The lamp reaches half of the points only: told so, the light is found; else it is not."""
    light = studio(1.0)
    seen = painted_ball(light, noise=0.0)
    shaded = torch.arange(len(seen.normals)) % 2 == 1
    to_lamp = light.directions @ LAMP > 0.7
    reach = torch.ones(len(seen.normals), len(light.directions))
    reach[shaded] = torch.where(to_lamp, 0.3, 1.0)
    falling = irradiance_of(seen.normals, light.directions)
    share = ((falling * reach) @ light.radiance) / (falling @ light.radiance).clamp_min(1e-6)
    dark = replace(seen, colors=seen.colors * share.pow(1 / ENCODING)[:, None])
    known = torch.ones(len(seen.normals), DIRECTIONS)
    known[shaded] = torch.where(sphere(DIRECTIONS) @ LAMP > 0.7, 0.3, 1.0)
    expected = shape_of(light)
    told, untold = (
        float((shape_of(found) - expected).square().mean().sqrt() / expected.std())
        for found in (fit_light(dark, known), fit_light(dark))
    )
    assert told < 0.25
    assert untold > 1.3 * told
    with pytest.raises(InputError, match=r"expected shares \(4000, 96\), got \(4000, 300\)"):
        fit_light(dark, reach)


def test_shares_belong_to_the_points_whose_normal_is_known() -> None:
    """Points without a normal, here the first half, do not shift those of the others."""
    seen = painted_ball(studio(1.0), noise=0.0)
    half = len(seen.normals) // 2
    normals = seen.normals.clone()
    normals[:half] = 0
    reach = torch.rand(2 * half, DIRECTIONS).clamp_min(0.3)
    found = fit_light(replace(seen, normals=normals), reach)
    rest = Observed(
        normals=seen.normals[half:], colors=seen.colors[half:], attention=seen.attention[half:]
    )
    torch.testing.assert_close(found.radiance, fit_light(rest, reach[half:]).radiance)


def test_a_shading_is_fitted_with_what_points_hide(monkeypatch: pytest.MonkeyPatch) -> None:
    """And keeps the points that it belongs to."""
    seen = painted_ball(studio(), count=1500)
    cloud = PointCloud(
        positions=F.normalize(torch.randn(1500, 3), dim=1),
        features=torch.zeros(1500, 1),
        influence=torch.ones(1500),
    )
    monkeypatch.setattr(light_fit, "observe", lambda *_, **__: seen)
    papr: Any = None
    found = fit_shading(papr, cloud, [])
    assert torch.equal(found.positions, cloud.positions)
    reach = reaching(cloud.positions, sphere(DIRECTIONS), cloud_spacing(cloud.positions))
    assert float(reach.min()) < 0.5, "half of a ball is hidden from any direction"
    assert torch.equal(found.light.radiance, fit_light(seen, reach).radiance)
    assert not torch.equal(found.light.radiance, fit_light(seen).radiance)


def test_the_same_light_from_everywhere_is_found_even() -> None:
    even = Light(directions=sphere(300), radiance=torch.ones(300))
    assert float(shape_of(fit_light(painted_ball(even))).std()) < 0.05


def test_it_is_the_same_every_time_and_the_seed_outside_stays() -> None:
    observed, before = painted_ball(studio()), torch.get_rng_state()
    first, second = fit_light(observed), fit_light(observed)
    assert torch.equal(first.radiance, second.radiance)
    assert torch.equal(before, torch.get_rng_state())


def test_too_few_normals_are_an_error() -> None:
    observed = painted_ball(studio(), count=400)
    few = Observed(
        normals=observed.normals * (torch.arange(400) < 49)[:, None],
        colors=observed.colors,
        attention=observed.attention,
    )
    with pytest.raises(InputError, match=r"at least 50 points with a normal .* got 49 of 400"):
        fit_light(few)


def test_one_colour_alone_is_enough() -> None:
    """Fewer different values than materials."""
    normal = sphere(600)
    light = studio()
    colors = (0.3 * light.irradiance(normal)[:, None]).pow(1 / ENCODING).expand(600, 3)
    found = fit_light(Observed(normals=normal, colors=colors, attention=torch.ones(600)))
    error = (shape_of(found) - shape_of(light)).square().mean().sqrt()
    assert float(error) < 0.25 * float(shape_of(light).std())


def test_no_points_at_all() -> None:
    nothing = Observed(
        normals=torch.zeros(0, 3), colors=torch.zeros(0, 3), attention=torch.zeros(0)
    )
    with pytest.raises(InputError, match="got 0 of 0"):
        fit_light(nothing)
