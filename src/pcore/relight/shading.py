"""How the light on points changes when an edit moves them.

Photos have the light baked into their colours, and an edit carries it along: a side that is turned
downwards stays as bright as it was. With an estimate of the light, the surface over every deformed
point gets the factor by which the light on it changes (docs/concepts/light.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.errors import InputError
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.neighbours import nearest
from pcore.geometry.surfels import Surfels
from pcore.geometry.visibility import cloud_spacing
from pcore.relight.lamps import ENCODING, Light, falling_of, known_normals, of_unit_length
from pcore.relight.shadows import Shadows, shadows_of

LARGEST_GAIN = 2.5
"""No point becomes brighter or darker by more than this factor: beyond, an estimate is no help."""
_DARKEST = 1e-3
_BOUNCES = 3
"""How often what hides light is lit anew itself."""
_BESIDE = 16
"""Pieces of surface around a point from which a ray chooses (ADR 14)."""


@dataclass(frozen=True, kw_only=True)
class Shading:
    """What it takes to light deformed points anew.

    Attributes:
        light: that of the photos.
        normals: (N, 3) unit normals of the canonical points, world axes; zero where none is known.
        positions: (N, 3) canonical points, world units.
        brightness: (N,) of the canonical points in the photos, linear, in the units of the light's
            radiance, at least 0; all float32 on the CPU.
        lift: how far above the points the surface lies, along their normals, world units.
    """

    light: Light
    normals: Tensor
    positions: Tensor
    brightness: Tensor
    lift: float

    def __post_init__(self) -> None:
        shapes = [tuple(one.shape) for one in (self.normals, self.positions, self.brightness)]
        if shapes[0][1:] != (3,) or shapes != [shapes[0], shapes[0], shapes[0][:1]]:
            raise InputError(
                "shading: expected normals (N, 3), positions (N, 3) and brightness (N,), got "
                f"{shapes[0]}, {shapes[1]} and {shapes[2]}"
            )
        for one in (self.normals, self.positions, self.brightness):
            if one.dtype != torch.float32 or one.device.type != "cpu":
                raise InputError(
                    f"shading: expected float32 on the CPU, got {one.dtype} on {one.device}"
                )
        if not bool(((self.brightness >= 0) & self.brightness.isfinite()).all()):
            raise InputError("shading: expected finite brightness of 0 or more")
        if not math.isfinite(self.lift):
            raise InputError(f"shading: expected a finite lift, got {self.lift}")
        unknown = (self.normals == 0).all(dim=1)
        if not bool((unknown | of_unit_length(self.normals)).all()):
            raise InputError("shading: expected normals of unit length, or zero where not known")

    @property
    def known(self) -> Tensor:
        """(N,) bool, the points whose normal is known."""
        return known_normals(self.normals)

    @cached_property
    def rest(self) -> Surfels:
        """The surface over the canonical points, in the light of the photos."""
        return Surfels(
            places=self.positions + self.lift * self.normals,
            normals=self.normals,
            beside=self._beside,
            spacing=self._spacing,
        )

    def skin(self, frames: LocalMaps, moved: Tensor, *, world: float = 1.0) -> Surfels:
        """Light the surface over deformed points anew.

        Args:
            frames: local frames of the deformed points, which say how their normals turn.
            moved: (N, 3) the deformed points, finite, world units.
            world: factor by which the lamps are scaled about the origin meanwhile.

        Returns:
            The surface and its factors, on the device of the points. A piece whose normal is not
            known keeps its brightness.

        Raises:
            InputError: frames of other points or without an inverse, points of another number, NaN
                or infinity, a factor that is not above 0.
        """
        if not (math.isfinite(world) and world > 0):
            raise InputError(f"shading: expected a world factor above 0, got {world}")
        self._check(frames, moved)
        to_rest = frames.to_rest.detach().cpu().float()
        lifted, wrong = torch.linalg.solve_ex(to_rest, self.lift * self.normals)
        flat = int(((wrong != 0) | ~lifted.isfinite().all(dim=1)).sum())
        if flat:
            raise InputError(
                f"shading: expected local maps with an inverse, got {flat} of {len(moved)} without"
            )
        # A normal turns by the transposed inverse of the local map, which the frames hold.
        turned = F.normalize(torch.einsum("nji,nj->ni", to_rest, self.normals), dim=1)
        place, spacing = moved.detach().cpu().float(), self._spacing * frames.growth
        skin = Surfels(
            places=place + lifted,
            normals=turned,
            beside=self._beside,
            spacing=spacing,
            gains=self._changes(place, turned, spacing, self.light.scaled(world)),
        )
        return skin.to(moved.device)

    def _changes(self, place: Tensor, turned: Tensor, spacing: float, light: Light) -> Tensor:
        """Bounded factors (N,) of points that an edit put to places (N, 3) and turned."""
        there = reaching(light, place, turned, shadows_of(place, turned, light.directions, spacing))
        gains = torch.ones(len(place))
        for _ in range(_BOUNCES):
            falls = there.on(self.brightness * gains.pow(ENCODING))
            change = (falls / self._at_rest).pow(1 / ENCODING)
            gains = change.clamp(1 / LARGEST_GAIN, LARGEST_GAIN)
        return gains

    def _check(self, frames: LocalMaps, moved: Tensor) -> None:
        counts = len(frames.rest), len(moved)
        if counts != (len(self.normals),) * 2:
            raise InputError(
                f"shading: expected frames of its {len(self.normals)} points and where they are, "
                f"got {counts[0]} and {counts[1]}; estimate the light anew (`pcore light RUN`)"
            )
        if not torch.equal(frames.rest.detach().cpu().float(), self.positions):
            raise InputError(
                "shading: expected frames from the points that the light was estimated with, got "
                "others; deform the canonical cloud"
            )
        bad = int((~torch.isfinite(moved).all(dim=1)).sum())
        if bad:
            raise InputError(
                f"shading: expected finite points, got NaN or infinity in {bad} of {len(moved)}"
            )

    @cached_property
    def _at_rest(self) -> Tensor:
        """Light (N,) on the points at rest."""
        here, light = (self.positions, self.normals), self.light
        shadows = shadows_of(*here, light.directions, self._spacing)
        return reaching(light, *here, shadows).on(self.brightness)

    @cached_property
    def _beside(self) -> Tensor:
        """Indices (N, 16) of the points with a normal that are nearest at rest; (N, 0) if none."""
        known = self.known.nonzero()[:, 0]
        if len(known) == 0:
            return torch.zeros(len(self.positions), 0, dtype=torch.int64)
        return known[nearest(self.positions[known], self.positions, _BESIDE)[0]]

    @cached_property
    def _spacing(self) -> float:
        return spacing_of(self.positions)


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


def reaching(light: Light, points: Tensor, normals: Tensor, shadows: Shadows) -> Reaching:
    """Light on points (N, 3) with normals (N, 3): from where a lamp is hidden shines what hides it.

    Args:
        light: the lamps.
        points: world units.
        normals: unit; zero where none is known: nothing falls on those.
        shadows: what the points hide from one another.
    """
    direct = (light.falling(points, normals) * shadows.open).sum(dim=1)
    return Reaching(
        direct=direct,
        share=hidden_share(normals, light.directions, shadows),
        hider=shadows.hider,
        least=_DARKEST * float(light.radiance.mean()),
    )


def hidden_share(normals: Tensor, directions: Tensor, shadows: Shadows) -> Tensor:
    """How much (N, D) of the light on normals (N, 3) other points of brightness 1 make up."""
    still = torch.zeros(len(directions))
    return falling_of(torch.zeros_like(normals), normals, directions, still) * (1 - shadows.open)


def spacing_of(points: Tensor) -> float:
    """How far points (N, 3) lie apart for `shadows_of`, world units; one alone hides nothing."""
    return cloud_spacing(points) if len(points) > 1 else 0.0
