"""A light that stands still: what it gives to surfaces, and how turned points change."""

import math

import pytest
import torch

from pcore.errors import InputError
from pcore.geometry.light import ENCODING, LARGEST_GAIN, Light, Shading
from pcore.geometry.local_frames import LocalFrames
from pcore.geometry.point_cloud import PointCloud
from pcore.training.light_fit import sphere

UP = torch.tensor([[0.0, 0.0, 1.0]])


def turn(angle: float) -> torch.Tensor:
    """About x, z towards -y."""
    cos, sin = math.cos(angle), math.sin(angle)
    return torch.tensor([[1.0, 0, 0], [0, cos, -sin], [0, sin, cos]])


def frames_of(maps: torch.Tensor) -> LocalFrames:
    """Frames of points that were moved by linear maps (N, 3, 3)."""
    return LocalFrames(rest=torch.zeros(len(maps), 3), to_rest=torch.linalg.inv(maps))


def even(radiance: float = 1.0) -> Light:
    return Light(directions=sphere(400), radiance=torch.full((400,), radiance))


def lamp(direction: torch.Tensor, share: float = 0.5) -> Light:
    """All directions the same, and one more as bright as `share` of everything."""
    directions = torch.cat([sphere(400), direction.reshape(1, 3)])
    radiance = torch.cat([torch.ones(400), torch.tensor([share * 400])])
    return Light(directions=directions, radiance=radiance)


def test_the_same_light_from_everywhere_gives_every_surface_one() -> None:
    normals = torch.nn.functional.normalize(torch.randn(50, 3), dim=1)
    torch.testing.assert_close(even().irradiance(normals), torch.ones(50), rtol=0, atol=0.02)


def test_one_lamp_follows_the_cosine() -> None:
    light = Light(directions=UP, radiance=torch.tensor([3.0]))
    normals = turn(math.radians(60)) @ UP[0]
    found = light.irradiance(torch.stack([UP[0], normals, -UP[0]]))
    torch.testing.assert_close(found, 4 * 3.0 * torch.tensor([1.0, 0.5, 0.0]))


def test_gains_are_the_ratio_of_light_as_photos_store_it() -> None:
    light = lamp(UP[0])
    shading = Shading(light=light, normals=UP.expand(3, 3))
    maps = torch.stack([torch.eye(3), turn(math.radians(60)), turn(math.radians(-120))])
    after = light.irradiance(maps @ UP[0])
    expected = (after / after[0]).pow(1 / ENCODING)
    torch.testing.assert_close(shading.gains(frames_of(maps)), expected)
    assert expected[2] < expected[1] < expected[0] == 1


def test_a_normal_follows_the_transposed_inverse() -> None:
    """A plane that faces (1, 0, 1) and is stretched along x faces more along z."""
    normal = torch.tensor([[1.0, 0.0, 1.0]]) / math.sqrt(2)
    stretched = torch.tensor([[0.5, 0.0, 1.0]]) / math.sqrt(1.25)
    light = lamp(UP[0])
    shading = Shading(light=light, normals=normal)
    found = shading.gains(frames_of(torch.diag(torch.tensor([2.0, 1.0, 1.0]))[None]))
    expected = light.irradiance(stretched) / light.irradiance(normal)
    torch.testing.assert_close(found, expected.pow(1 / ENCODING))


@pytest.mark.parametrize("scale", [0.25, 1.0, 3.0])
def test_growth_and_moves_change_no_light(scale: float) -> None:
    normals = torch.nn.functional.normalize(torch.randn(20, 3), dim=1)
    found = Shading(light=lamp(UP[0]), normals=normals).gains(
        frames_of(scale * torch.eye(3).expand(20, 3, 3))
    )
    torch.testing.assert_close(found, torch.ones(20), rtol=0, atol=1e-5)


def test_no_turn_matters_in_the_same_light_from_everywhere() -> None:
    normals = torch.nn.functional.normalize(torch.randn(20, 3), dim=1)
    maps = torch.stack([turn(angle) for angle in torch.linspace(0.1, 3, 20).tolist()])
    found = Shading(light=even(), normals=normals).gains(frames_of(maps))
    torch.testing.assert_close(found, torch.ones(20), rtol=0, atol=0.02)


def test_points_without_a_normal_stay_and_gains_are_bounded() -> None:
    light = Light(directions=UP, radiance=torch.ones(1))
    shading = Shading(light=light, normals=torch.cat([UP, -UP, torch.zeros(1, 3)]))
    assert shading.known.tolist() == [True, True, False]
    found = shading.gains(frames_of(turn(math.pi).expand(3, 3, 3)))
    assert found.tolist() == pytest.approx([1 / LARGEST_GAIN, LARGEST_GAIN, 1.0])


def test_a_light_is_checked() -> None:
    with pytest.raises(InputError, match=r"directions \(D, 3\) and radiance \(D,\), got \(1, 3\)"):
        Light(directions=UP, radiance=torch.ones(2))
    for radiance in (torch.tensor([-1.0]), torch.tensor([0.0]), torch.tensor([math.nan])):
        with pytest.raises(InputError, match="radiance of 0 or more, and some of it above 0"):
            Light(directions=UP, radiance=radiance)
    with pytest.raises(InputError, match=r"normals \(N, 3\)"):
        Shading(light=even(), normals=torch.zeros(4))
    shading = Shading(light=even(), normals=UP)
    with pytest.raises(InputError, match=r"frames of its 1 points, got 2; .*`pcore light RUN`"):
        shading.gains(frames_of(torch.eye(3).expand(2, 3, 3)))


def test_a_cloud_keeps_its_gains_until_it_moves() -> None:
    cloud = PointCloud(
        positions=torch.zeros(2, 3), features=torch.zeros(2, 4), influence=torch.ones(2)
    )
    lit = cloud.lit(torch.tensor([2.0, 0.5]))
    assert cloud.gains is None
    for same in (lit, lit.detached(), lit.to("cpu")):
        assert same.gains is not None
        assert same.gains.tolist() == [2.0, 0.5]
    assert lit.moved(torch.ones(2, 3)).gains is None, "they belong to where the points were"
    with pytest.raises(InputError, match=r"gains of its 2 points, got \(3,\)"):
        cloud.lit(torch.ones(3))
