"""Splats as browsers draw them: Gaussians with one colour each, for where they are seen from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from pcore.errors import InputError
from pcore.gaussians.covariance import covariances
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.seen_colors import seen_colors
from pcore.kernels.cpu_carry import carried_shapes

Floats = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Splats:
    """N splats in world units, float32 arrays.

    Attributes:
        centers: (N, 3).
        covariances: (N, 3, 3) world units squared.
        rgb: (N, 3) in [0, 1].
        opacities: (N,) in [0, 1].
    """

    centers: Floats
    covariances: Floats
    rgb: Floats
    opacities: Floats

    def __len__(self) -> int:
        return len(self.centers)


@dataclass(frozen=True, kw_only=True, eq=False)
class SplatsAtRest:
    """Gaussians at rest, ready to be carried along by what happens to points.

    Attributes:
        gaussians: N of them, on the CPU.
        points: (N, 3) the points that they go with, world units; they may lie beside them.
        covariances: (N, 3, 3) float32 of the Gaussians.
    """

    gaussians: Gaussians
    points: Tensor
    covariances: Tensor

    @classmethod
    def of(cls, gaussians: Gaussians, points: Tensor | None = None) -> SplatsAtRest:
        """Prepare Gaussians that go with points (N, 3); None: their means are the points."""
        plain = gaussians.detached().to("cpu", torch.float32)
        shapes = covariances(plain.quats, plain.scales).contiguous()
        points = plain.means if points is None else points.detach().cpu().float()
        return cls(gaussians=plain, points=points, covariances=shapes)

    @cached_property
    def _beside(self) -> Tensor | None:
        """(N, 3) from the points to the means; None where the means are the points."""
        beside = self.gaussians.means - self.points
        return beside if bool(beside.any()) else None

    @torch.no_grad()
    def moved(
        self,
        positions: Tensor,
        local_maps: Tensor | None,
        eye: Tensor,
        gains: Tensor | None = None,
    ) -> Splats:
        """Carry them along.

        Args:
            positions: (N, 3) where the points are, world units.
            local_maps: (N, 3, 3) Jacobians there; None leaves shapes and colours as at rest.
            eye: (3,) the camera, world units.
            gains: (N,) factors on the brightness; None leaves it as it is.

        Raises:
            InputError: of another number of points, or an eye that is no place.
        """
        count, eye = len(self.points), torch.as_tensor(eye, dtype=torch.float32).detach().cpu()
        if tuple(positions.shape) != (count, 3) or tuple(eye.shape) != (3,):
            raise InputError(
                f"splats: expected positions ({count}, 3) and an eye (3,), got "
                f"{tuple(positions.shape)} and {tuple(eye.shape)}"
            )
        centers, beside = positions.detach().cpu().float(), self._beside
        shapes, maps = self.covariances, local_maps
        if maps is not None:
            maps = maps.detach().cpu().double().contiguous()
        if maps is not None and beside is not None:
            centers = centers + (maps @ beside.double().unsqueeze(-1)).squeeze(-1).float()
        elif beside is not None:
            centers = centers + beside
        seen = F.normalize(centers - eye, dim=1)
        if maps is not None:
            shapes, seen = carried_shapes(shapes, maps, seen)
        rgb = seen_colors(self.gaussians.sh, seen)
        if gains is not None:
            rgb = rgb * gains.detach().cpu().reshape(count, -1)
        return Splats(
            centers=centers.numpy(),
            covariances=shapes.numpy(),
            rgb=rgb.clamp(0.0, 1.0).numpy(),
            opacities=self.gaussians.opacities.numpy(),
        )
