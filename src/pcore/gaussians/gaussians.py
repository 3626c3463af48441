"""Objects made of three-dimensional Gaussians, as 3D Gaussian Splatting learns them."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.gaussians.spherical_harmonics import HIGHEST_DEGREE
from pcore.geometry.tensors import Tensors

THINNEST = 1e-4
"""Third scale of a flat Gaussian as a share of its smaller one, in files that have three."""
_UNIT = 1e-3
"""How far from 1 the length of a quaternion may be; single precision keeps 1e-6."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Gaussians(Tensors):
    """N Gaussians in world space.

    Attributes:
        means: (N, 3) world units.
        quats: (N, 4) unit quaternions w, x, y, z of the axes: `world_from_axes`.
        scales: (N, 3) standard deviations along the axes, greater than 0, world units.
        opacities: (N,) 0 to 1.
        sh: (N, K, 3) coefficients of real spherical harmonics, red, green, blue, with
            K = (degree + 1)^2; see `pcore.gaussians.spherical_harmonics` for the basis.
    """

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    sh: Tensor

    def __post_init__(self) -> None:
        got = [tuple(getattr(self, field.name).shape) for field in fields(self)]
        n, k = self.means.shape[0] if self.means.ndim else 0, got[4][1] if len(got[4]) == 3 else 0
        if got != [(n, 3), (n, 4), (n, 3), (n,), (n, k, 3)]:
            raise InputError(
                "gaussians: expected means (N, 3), quats (N, 4), scales (N, 3), opacities (N,) and "
                f"sh (N, K, 3), got {', '.join(map(str, got))}"
            )
        if k not in [(degree + 1) ** 2 for degree in range(HIGHEST_DEGREE + 1)]:
            raise InputError(
                "gaussians: expected (degree + 1)^2 coefficients of spherical harmonics, degree 0 "
                f"to {HIGHEST_DEGREE}, got {k}"
            )

    @property
    def degree(self) -> int:
        """Highest degree of the spherical harmonics."""
        return math.isqrt(self.sh.shape[1]) - 1

    def __len__(self) -> int:
        return self.means.shape[0]

    def checked(self, where: str) -> Gaussians:
        """Return the same after a look at every value; for what comes from files and users.

        Args:
            where: starts the message; a file's path.

        Raises:
            InputError: no Gaussians; NaN or infinity; quaternions that are not of unit length;
                scales that are not greater than 0; opacities outside 0 to 1, or all of them 0.
        """
        if not len(self):
            raise InputError(f"{where}: expected at least one Gaussian, got none")
        for field in fields(self):
            good = torch.isfinite(getattr(self, field.name).detach()).reshape(len(self), -1)
            self._demand(where, good.all(dim=1), f"finite {field.name}", "NaN or infinity")
        quats, scales, opacities = (
            self.quats.detach(),
            self.scales.detach(),
            self.opacities.detach(),
        )
        unit = (quats.norm(dim=1) - 1).abs() <= _UNIT
        self._demand(where, unit, "quaternions of unit length", "other lengths")
        self._demand(where, (scales > 0).all(dim=1), "scales greater than 0", "zero or less")
        proper = (opacities >= 0) & (opacities <= 1)
        self._demand(where, proper, "opacities from 0 to 1", "others")
        if not bool((opacities > 0).any()):
            raise InputError(
                f"{where}: expected Gaussians that can be seen, got opacity 0 in all {len(self)}"
            )
        return self

    def _demand(self, where: str, good: Tensor, expected: str, got: str) -> None:
        bad = int((~good).sum())
        if bad:
            raise InputError(
                f"{where}: expected {expected}, got {got} in {bad:,} of {len(self):,} Gaussians"
            )
