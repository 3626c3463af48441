"""Light on Gaussians: a ball of flat ones under a lamp of the sky that is known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.surfels import Surfels
from pcore.relight.gaussian_light import LitPieces, fit_gaussian_light, gaussian_gains, lit_of
from pcore.relight.lamps import Light, sphere
from pcore.relight.relighting import Relighting
from pcore.render.surfel_fit import Observed

COUNT, LAMPS = 500, 192
BALL = sphere(COUNT)
"""Places and normals of a ball of radius 1."""


def sky(strength: float = 0.8) -> Light:
    """A sky whose radiance grows linearly with height: 1 + s z, which falls linearly, too."""
    directions = sphere(LAMPS)
    return Light(
        directions=directions,
        radiance=1 + strength * directions[:, 2],
        nearness=torch.zeros(LAMPS),
        center=torch.zeros(3),
    )


def falling(normals: Tensor, strength: float = 0.8) -> Tensor:
    """What that sky sends to normals: the mean of 4 <n, w>+ (1 + s z) over the sphere.

    The cosine's mean is 1/4, and that of <n, w>+ w is n / 6: 1 + 2 s n_z / 3.
    """
    return 1 + 2 * strength * normals[:, 2] / 3


@dataclass(frozen=True)
class Ball:
    """Pieces of surface and the light on them."""

    relighting: Relighting
    surfels: Surfels

    def gains(self, linear: Tensor, *, world: float = 1.0) -> Tensor:
        """Factors when a linear map (3, 3) moves all of it."""
        positions = self.surfels.places @ linear.T
        maps = LocalMaps(to_rest=torch.linalg.inv(linear).repeat(len(positions), 1, 1))
        return gaussian_gains(
            self.relighting, LitPieces.of(self.surfels), positions, maps, world=world
        )


def ball(unknown: int = 0, light: Light | None = None) -> Ball:
    """The first `unknown` pieces have no normal."""
    normals = BALL.clone()
    normals[:unknown] = 0
    surfels = Surfels.at_rest(BALL, normals, torch.zeros(COUNT))
    lit = lit_of(normals)
    over = Surfels.at_rest(BALL[lit], normals[lit], torch.zeros(len(lit)))
    dark = torch.zeros(len(lit))
    return Ball(Relighting.of(light or sky(), BALL[lit], over, dark), surfels)


def turn(angle: float) -> Tensor:
    """About x, z towards -y."""
    cos, sin = math.cos(angle), math.sin(angle)
    return torch.tensor([[1.0, 0, 0], [0, cos, -sin], [0, sin, cos]])


def observed(normals: Tensor, colors: Tensor) -> Observed:
    count = len(normals)
    return Observed(
        normals=normals, colors=colors, attention=torch.ones(count), heights=torch.zeros(count)
    )


def test_at_rest_nothing_changes() -> None:
    """Up to the last bits of the normals."""
    torch.testing.assert_close(ball(40).gains(torch.eye(3)), torch.ones(COUNT), atol=1e-5, rtol=0)


def test_what_turns_gets_the_light_of_where_it_faces() -> None:
    """The ball is convex, so that nothing hides anything, but for the grid of the shadow maps.

    192 lamps stand for the sky to some 1/192 of each integral, and the quotient of two of them,
    to the power 1/2.2, is right to 2/192/2.2 < 0.5 %. At grazing light a ball's shell may hide a
    cell beside it: the cosine there is small, so that a few percent are allowed.
    """
    linear = turn(math.pi / 2)
    truth = (falling(BALL @ linear.T) / falling(BALL)).pow(1 / 2.2)
    found = ball().gains(linear)
    assert float((found / truth).log().abs().mean()) < 0.005
    assert float((found / truth).log().abs().max()) < 0.03
    assert float(truth.log().abs().mean()) > 0.1


def test_those_without_a_normal_take_the_light_of_their_neighbours() -> None:
    """Of the pole's cap nothing is known: what lies around it tells. Others do not feel them."""
    linear = turn(math.pi / 2)
    whole, some = ball().gains(linear), ball(20).gains(linear)
    # The cap's radius is 2 sqrt(20 / 500) = 0.4: light's slope is below 0.5 per unit there.
    assert float((some[:20] / whole[:20]).log().abs().max()) < 0.25
    assert float(some[:20].log().abs().min()) > 0
    assert float((some[60:] / whole[60:]).log().abs().max()) < 0.02


def test_a_larger_world_has_the_same_light() -> None:
    near = Light(
        directions=sphere(LAMPS),
        radiance=1 + 0.8 * sphere(LAMPS)[:, 2],
        nearness=torch.full((LAMPS,), 0.3),
        center=torch.zeros(3),
    )
    one = ball(light=near)
    still = one.gains(2 * torch.eye(3), world=2.0)
    torch.testing.assert_close(still, torch.ones(COUNT), atol=1e-3, rtol=0)
    # Lamps that stay where they are come nearer to a ball that grows.
    assert float((one.gains(2 * torch.eye(3)) - 1).abs().max()) > 0.05


def test_the_light_is_found_in_the_colours() -> None:
    """A ball of one paint: what an estimate tells is right where it turns, to a few percent."""
    shade = (0.4 * falling(BALL)).pow(1 / 2.2)
    colors = shade[:, None].expand(-1, 3) * torch.tensor([1.0, 0.7, 0.5])
    relighting = fit_gaussian_light(observed(BALL, colors), BALL)
    surfels = Surfels.at_rest(BALL, BALL, torch.zeros(COUNT))
    linear = turn(math.pi / 2)
    truth = (falling(BALL @ linear.T) / falling(BALL)).pow(1 / 2.2)
    found = Ball(relighting, surfels).gains(linear)
    off = float((found / truth).log().abs().mean())
    assert off < 0.2 * float(truth.log().abs().mean())


def test_too_few_pieces_of_surface_are_said() -> None:
    normals = torch.zeros(COUNT, 3)
    normals[:10] = BALL[:10]
    with pytest.raises(InputError, match="at least 50 points"):
        fit_gaussian_light(observed(normals, torch.full((COUNT, 3), 0.5)), BALL)
    assert len(lit_of(torch.zeros(4, 3))) == 0


def test_very_many_are_thinned_evenly() -> None:
    normals = torch.tensor([[0.0, 0.0, 1.0]]).repeat(50_000, 1)
    lit = lit_of(normals)
    assert len(lit) == 20_000
    assert (int(lit[0]), int(lit[-1])) == (0, 49_999)
    assert bool((lit[1:] > lit[:-1]).all())
