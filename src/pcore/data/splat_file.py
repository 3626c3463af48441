"""Gaussians as they stand in a file, with what of it has to be kept."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from pcore.data.ply import Ply
from pcore.data.point_ply import turned
from pcore.errors import InputError
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint

_LARGEST = 1e18
"""World units; the square of more is not finite in single precision."""
_MOST_LOST = 0.5
_FAINTEST = 1 / 255
"""Opacity from which on a Gaussian is drawn."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SplatFile:
    """What a file of Gaussians holds.

    Attributes:
        gaussians: N of them, on the CPU, float64 but for `sh`, which is float32.
        where: the file, for messages.
        rows: (N,) which of the file's Gaussians each is, or is a part of.
        ply: a PLY as it stands in the file, else None.
        normals: (N, 3) of a PLY that has normals other than zero.
        flat: whether the file gives two scales (2DGS); the third of `gaussians` is then tiny.
        footprint: how its trainer met pixels, where the file says so, or is to say so.
        notes: what of the file was left out, for the user.
    """

    gaussians: Gaussians
    where: str
    rows: NDArray[np.int64]
    ply: Ply | None = None
    normals: NDArray[np.float64] | None = None
    flat: bool = False
    footprint: Footprint | None = None
    notes: tuple[str, ...] = ()

    def chosen(self, index: NDArray[np.int64]) -> SplatFile:
        """Return the file with these of its Gaussians (M,), some perhaps more than once."""
        places = torch.from_numpy(index)
        return replace(
            self,
            gaussians=self.gaussians.each(lambda tensor: tensor[places]),
            rows=self.rows[index],
            normals=None if self.normals is None else self.normals[index],
        )

    def moved(self, gaussians: Gaussians, local_maps: NDArray[np.float64]) -> SplatFile:
        """Return the file with its Gaussians moved, and its normals turned by maps (N, 3, 3)."""
        normals = None if self.normals is None else turned(self.normals, local_maps)
        return replace(self, gaussians=gaussians, normals=normals)


def splats_of(
    gaussians: Gaussians, where: str, *, flat: bool = False, footprint: Footprint | None = None
) -> SplatFile:
    """Return Gaussians that no file has held yet, as one of that name; nothing is checked."""
    own = gaussians.detached().to("cpu")
    wide = own.to(dtype=torch.float64)
    numbers = np.arange(len(own), dtype=np.int64)
    exact = replace(wide, sh=own.sh.float())
    return SplatFile(gaussians=exact, where=where, rows=numbers, flat=flat, footprint=footprint)


def filter_words(footprint: Footprint) -> str:
    """A screen filter as the options of `pcore import gaussians` that stand for it."""
    return f"--variance {footprint.variance:.3g}" + " --antialiased" * footprint.antialiased


def sound(file: SplatFile) -> SplatFile:
    """Leave out Gaussians that are none, and say how many; check the others.

    None are those with NaN or infinity, without axes (a quaternion of length 0), or so large
    or far away that squares are not finite in single precision.

    Raises:
        InputError: more than half of them are none, or nothing can be seen of the others.
    """
    own = file.gaussians
    if not len(own):
        raise InputError(f"{file.where}: expected at least one Gaussian, got none; it is empty")
    good = torch.ones(len(own), dtype=torch.bool)
    for tensor in (own.means, own.quats, own.scales, own.opacities, own.sh):
        good &= torch.isfinite(tensor).reshape(len(own), -1).all(dim=1)
    good &= (own.quats.norm(dim=1) - 1).abs() < 1e-3
    good &= (own.scales < _LARGEST).all(dim=1) & (own.means.abs() < _LARGEST).all(dim=1)
    bad = int((~good).sum())
    if bad > _MOST_LOST * len(own):
        raise InputError(
            f"{file.where}: expected Gaussians, got NaN, infinity, sizes whose squares are not "
            f"finite or quaternions without length in {bad:,} of {len(own):,}; the training "
            "diverged or the file is damaged"
        )
    if bad:
        note = f"{bad:,} of {len(own):,} Gaussians are not finite or have no axes: left out"
        kept = file.chosen(np.flatnonzero(good.numpy()))
        file = replace(kept, notes=(*file.notes, note))
    file.gaussians.checked(file.where)
    faint = float(file.gaussians.opacities.max())
    if faint < _FAINTEST:
        raise InputError(
            f"{file.where}: expected Gaussians that can be seen, got opacities of at most "
            f"{faint:.2g}; none below 1 / 255 is drawn; the training diverged or the file "
            "is damaged"
        )
    return file
