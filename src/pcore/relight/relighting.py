"""How the light on points changes when an edit moves them.

Photos have the light baked into their colours, and an edit carries it along: a side that is turned
downwards stays as bright as it was. With an estimate of the light, the surface over every deformed
point gets the factor by which the light on it changes (docs/concepts/light.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.posed import PosedCloud
from pcore.geometry.surfels import Surfels
from pcore.geometry.tensors import Tensors
from pcore.relight.lamps import Light, falling_of
from pcore.relight.relight_config import DEFAULT, RelightConfig
from pcore.relight.shadows import Shadows, shadows_of

NO_GRADIENT = (
    "light: a gradient is asked for, and shadows have none; pose without a light that stands still "
    '(light="baked"), or use torch.no_grad()'
)


@dataclass(frozen=True, kw_only=True, repr=False)
class Relighting(Tensors):
    """What it takes to light posed points anew.

    Attributes:
        light: that of the photos.
        positions: (N, 3) the canonical points that it fell on, world units.
        brightness: (N,) of these points in the photos, linear, in the units of the light's
            radiance, at least 0.
        received: (N,) light that fell on them; all float32 on the CPU.
        config: constants that the light was estimated with.
    """

    light: Light
    positions: Tensor
    brightness: Tensor
    received: Tensor
    config: RelightConfig = DEFAULT

    def __post_init__(self) -> None:
        parts = (self.positions, self.brightness, self.received)
        shapes = [tuple(one.shape) for one in parts]
        if shapes[0][1:] != (3,) or shapes[1:] != [shapes[0][:1]] * 2:
            raise InputError(
                "light: expected positions (N, 3), brightness (N,) and received light (N,), got "
                f"{shapes[0]}, {shapes[1]} and {shapes[2]}"
            )
        for one in parts:
            if one.dtype != torch.float32 or one.device.type != "cpu":
                raise InputError(
                    f"light: expected float32 on the CPU, got {one.dtype} on {one.device}"
                )
        if not bool(((self.brightness >= 0) & self.brightness.isfinite()).all()):
            raise InputError("light: expected finite brightness of 0 or more")
        if not bool(((self.received > 0) & self.received.isfinite()).all()):
            raise InputError("light: expected finite light above 0 on every point at rest")

    @classmethod
    def of(
        cls,
        light: Light,
        positions: Tensor,
        surfels: Surfels,
        brightness: Tensor,
        config: RelightConfig = DEFAULT,
    ) -> Relighting:
        """Let a light fall on canonical points (N, 3) with surfels and a brightness (N,)."""
        here = positions, surfels.normals
        shadows = shadows_of(*here, light.directions, float(surfels.spacing), config)
        received = reaching(light, *here, shadows, config).on(brightness)
        return cls(
            light=light,
            positions=positions,
            brightness=brightness,
            received=received,
            config=config,
        )

    def gains(self, posed: PosedCloud, *, world: float = 1.0) -> Tensor:
        """Find by which factor the light on posed points has changed, while it stands still.

        Args:
            posed: the points with their surfels, finite, world units.
            world: factor by which the lamps are scaled about the origin meanwhile.

        Returns:
            Bounded factors (N,) on the brightness that photos stored, on the device of the points;
            1 where no normal is known.

        Raises:
            InputError: other canonical points, no surfels, NaN or infinity, a factor that is not
                above 0, or a pose that autograd follows: shadows have no gradient.
        """
        if not (math.isfinite(world) and world > 0):
            raise InputError(f"light: expected a world factor above 0, got {world}")
        surfels = self._check(posed)
        place = posed.positions.detach().cpu().float()
        turned, light = surfels.normals.detach().cpu().float(), self.light.scaled(world)
        spacing = float(surfels.spacing)
        shadows = shadows_of(place, turned, light.directions, spacing, self.config)
        there = reaching(light, place, turned, shadows, self.config)
        encoding, most = self.config.encoding, self.config.largest_gain
        gains = torch.ones(len(place))
        for _ in range(self.config.bounces):
            falls = there.on(self.brightness * gains.pow(encoding))
            gains = (falls / self.received).pow(1 / encoding).clamp(1 / most, most)
        return gains.to(posed.positions.device)

    def _check(self, posed: PosedCloud) -> Surfels:
        """Raise InputError where `gains` would; return the surfels."""
        rest = posed.cloud.positions.detach().cpu().float()
        if rest.shape != self.positions.shape or not torch.equal(rest, self.positions):
            raise InputError(
                f"light: expected the {len(self.positions)} canonical points that it was estimated "
                f"with, got {len(rest)} others; estimate it anew (`pcore light RUN`)"
            )
        if posed.surfels is None:
            raise InputError("light: expected points with surfels, got none for light to fall on")
        followed = (posed.positions, posed.surfels.places, posed.surfels.normals)
        if torch.is_grad_enabled() and any(one.requires_grad for one in followed):
            raise InputError(NO_GRADIENT)
        bad = int((~torch.isfinite(posed.positions).all(dim=1)).sum())
        if bad:
            raise InputError(
                f"light: expected finite points, got NaN or infinity in {bad} of {len(posed)}"
            )
        return posed.surfels


@dataclass(frozen=True, kw_only=True)
class Reaching:
    """The light that reaches N points, one bounce off other points among it.

    Attributes:
        direct: (N,) from the lamps.
        share: (N, D) of the brightness of what hides a lamp that falls on a point instead.
        hider: (N, D) int32, what hides it.
        least: light that every point has at least, so that ratios stay finite.
    """

    direct: Tensor
    share: Tensor
    hider: Tensor
    least: float

    def on(self, brightness: Tensor) -> Tensor:
        """Light (N,) on the points when they are so bright (N,) themselves."""
        bounced = (self.share * brightness[self.hider]).sum(dim=1)
        return (self.direct + bounced).clamp_min(self.least)


def reaching(
    light: Light,
    points: Tensor,
    normals: Tensor,
    shadows: Shadows,
    config: RelightConfig = DEFAULT,
) -> Reaching:
    """Light on points (N, 3) with normals (N, 3): from where a lamp is hidden shines what hides it.

    Args:
        light: the lamps.
        points: world units.
        normals: unit; zero where none is known: nothing falls on those.
        shadows: what the points hide from one another.
        config: constants.
    """
    direct = (light.falling(points, normals, config) * shadows.open).sum(dim=1)
    return Reaching(
        direct=direct,
        share=hidden_share(normals, light.directions, shadows),
        hider=shadows.hider,
        least=config.darkest * float(light.radiance.mean()),
    )


def hidden_share(normals: Tensor, directions: Tensor, shadows: Shadows) -> Tensor:
    """How much (N, D) of the light on normals (N, 3) other points of brightness 1 make up."""
    still = torch.zeros(len(directions))
    return falling_of(torch.zeros_like(normals), normals, directions, still) * (1 - shadows.open)
