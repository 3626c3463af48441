"""The light of `benchmarks/fixed_light.py` is found among patches of different brightness."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch

from pcore.geometry.local_frames import LocalFrames
from pcore.geometry.point_cloud import PointCloud

BENCHMARKS = str(Path(__file__).parents[2] / "benchmarks")

LIGHT = torch.tensor([0.1, -0.2, 0.4, 0.05, -0.1, 0.0, 0.1, 0.02])


@pytest.fixture(autouse=True)
def path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(BENCHMARKS)


def patched_sphere(count: int = 4000):
    """A sphere of four paints, two of one hue, lit by LIGHT."""
    from fixed_light import Surface, harmonics

    generator = torch.Generator().manual_seed(3)
    normal = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1)
    paints = torch.tensor([[0.1, 0.1, 0.1], [0.4, 0.4, 0.4], [0.5, 0.2, 0.1], [0.1, 0.3, 0.5]])
    paint = paints[torch.randint(0, 4, (count,), generator=generator)]
    color = paint * (harmonics(normal) @ LIGHT).exp()[:, None]
    known = torch.ones(count, dtype=torch.bool)
    return Surface(normals=normal, colors=color, seen=torch.ones(count), known=known)


def test_the_light_is_found_whatever_the_paint() -> None:
    from fixed_light import fit_light

    # The brightness floor of dark surfaces flattens the light a little.
    torch.testing.assert_close(fit_light(patched_sphere()), LIGHT, rtol=0, atol=0.06)


def test_a_turn_takes_a_surface_into_other_light() -> None:
    from fixed_light import light_gains

    surface = patched_sphere(2)
    surface.normals[0] = torch.tensor([0.0, 0.0, 1.0])
    surface.normals[1] = torch.tensor([1.0, 0.0, 0.0])
    turn = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # z to -y
    frames = LocalFrames(rest=torch.zeros(2, 3), to_rest=turn.T.expand(2, 3, 3))
    cloud = PointCloud(
        positions=torch.zeros(2, 3), features=torch.zeros(2, 1), influence=torch.ones(2)
    )
    light = torch.tensor([0.0, 0, 0.5, 0, 0, 0, 0, 0])  # From above.
    gains = light_gains(surface, light, cloud.moved(cloud.positions, frames))
    assert gains.tolist() == pytest.approx([math.exp(-0.5), 1.0])
    assert light_gains(surface, light, cloud).tolist() == [1.0, 1.0]
