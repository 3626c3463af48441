"""Gaussians in PLY files, as the trainers of INRIA, gsplat, nerfstudio and 2DGS write them.

Each vertex is a Gaussian: x y z, f_dc_0 to 2 and f_rest_* (spherical harmonics, all of red, then
green, then blue), opacity (logit), scale_* (natural logarithm; 2DGS has two), rot_0 to 3
(quaternion w x y z of any length). nerfstudio may write red green blue instead of the harmonics.
None of them says how Gaussians met pixels; files of ours do in a comment, see `_told`.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pcore.data.ply import Place, Ply, binary_ply
from pcore.data.splat_file import SplatFile, sound
from pcore.errors import InputError
from pcore.gaussians.gaussians import THINNEST, Gaussians
from pcore.gaussians.render import Footprint
from pcore.gaussians.spherical_harmonics import HIGHEST_DEGREE, basis

CONSTANT = float(basis(0, torch.zeros(3, dtype=torch.float64)))
"""The harmonic of degree 0."""

_PLACES = ("x", "y", "z")
_QUAT = ("rot_0", "rot_1", "rot_2", "rot_3")
_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
_PAINT = ("red", "green", "blue")
_NORMALS = ("nx", "ny", "nz")
_SIGNS = ("f_dc_0", "scale_0", "rot_0", "opacity")
"""Properties that only Gaussians have together."""
_COMMENT = re.compile(
    r"pcore footprint variance=(\d+(?:\.\d+)?(?:e[+-]?\d+)?) antialiased=([01]) flat=[01]"
)
_SMALLEST_LOG = -50.0
_SURE = 1e-7


def is_gaussian(ply: Ply) -> bool:
    """Whether the vertices of a PLY are Gaussians, or were meant to be."""
    found = ply.element("vertex")
    if found is None:
        return False
    return sum(found[1].find(name) is not None for name in _SIGNS) >= 2


def read_gaussian_ply(ply: Ply, where: str) -> SplatFile:
    """Read the Gaussians of a PLY file.

    Args:
        ply: the file, of which `is_gaussian` says so.
        where: its name, for messages.

    Raises:
        InputError: properties are missing, are lists or fit no degree of harmonics; or see `sound`.
    """
    vertices = _Vertices(ply, where)
    flat = vertices.has("scale_0", "scale_1") and not vertices.has("scale_2")
    scales = _names("scale_", 2 if flat else 3)
    vertices.demand((*_PLACES, "opacity", *scales, *_QUAT))
    quats = vertices.read(_QUAT)
    gaussians = Gaussians(
        means=vertices.read(_PLACES),
        quats=quats / quats.norm(dim=1, keepdim=True),
        scales=_scales(vertices.read(scales)),
        opacities=torch.sigmoid(vertices.read(("opacity",)).squeeze(1)),
        sh=_harmonics(vertices),
    )
    normals = vertices.read(_NORMALS).numpy() if vertices.real(*_NORMALS) else None
    return sound(
        SplatFile(
            gaussians=gaussians,
            where=where,
            rows=np.arange(len(gaussians), dtype=np.int64),
            ply=ply,
            normals=normals if normals is not None and normals.any() else None,
            flat=flat,
            footprint=_footprint(ply, flat=flat),
        )
    )


def gaussian_ply(file: SplatFile) -> bytes:
    """Content of a PLY file; one that was read from a PLY keeps all its properties.

    Where Gaussians were left out or split, elements besides the vertices are lost; see `lost`.
    """
    columns = _columns(file.gaussians, flat=file.flat)
    if file.ply is None:
        first = {name: columns.pop(name) for name in _PLACES}
        all_columns = {**first, **dict.fromkeys(_NORMALS, np.zeros(len(file.rows))), **columns}
        singles = {name: values.astype(np.float32) for name, values in all_columns.items()}
        return binary_ply(singles, comments=_told(file))
    vertices = _Vertices(file.ply, file.where)
    if len(np.unique(file.rows)) == len(file.rows):
        # Nothing but a split changes how dense Gaussians are.
        del columns["opacity"]
    if file.normals is not None:
        columns |= dict(zip(_NORMALS, file.normals.T, strict=True))
    new = {name: values for name, values in columns.items() if vertices.has(name)}
    if np.array_equal(file.rows, np.arange(vertices.element.length)):
        return file.ply.replaced({vertices.place(name): new[name] for name in new})
    types, values = vertices.types(), vertices.all_rows(file.rows) | new
    return binary_ply(
        {name: values[name].astype(types[name]) for name in values}, None, _told(file)
    )


def lost(file: SplatFile) -> tuple[str, ...]:
    """Names of elements of the PLY that `gaussian_ply` cannot keep."""
    if file.ply is None:
        return ()
    vertices = _Vertices(file.ply, file.where)
    if np.array_equal(file.rows, np.arange(vertices.element.length)):
        return ()
    others = [one for one in file.ply.header.elements if one.length and one is not vertices.element]
    return tuple(f"{one.length:,} {one.name}" for one in others)


class _Vertices:
    """The vertices of a PLY by the names of their properties."""

    def __init__(self, ply: Ply, where: str) -> None:
        found = ply.element("vertex")
        assert found is not None
        self.ply, self.where = ply, where
        self.number, self.element = found

    def has(self, *names: str) -> bool:
        return all(self.element.find(name) is not None for name in names)

    def place(self, name: str) -> Place:
        one = self.element.find(name)
        assert one is not None
        return self.number, one

    def demand(self, names: tuple[str, ...], *, real: bool = True) -> None:
        missing = [name for name in names if not self.has(name)]
        others = [name for name in names if self.has(name) and not self._fits(name, real)]
        if missing or others:
            what = f"no {', '.join(missing)}" if missing else f"other types in {', '.join(others)}"
            raise InputError(
                f"{self.where}: expected Gaussians with real numbers {', '.join(names)}, got "
                f"{what}; export the splats again as an uncompressed PLY"
            )

    def read(self, names: tuple[str, ...]) -> Tensor:
        """Values (N, len(names)) float64."""
        stacked = np.empty((self.element.length, len(names)), dtype=np.float64)
        with np.errstate(invalid="ignore"):
            for column, name in enumerate(names):
                stacked[:, column] = self.ply.scalars(self.place(name))
        return torch.from_numpy(stacked)

    def all_rows(self, rows: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """Values (M,) of all properties but lists at these rows."""
        return {name: self.ply.scalars(self.place(name))[rows] for name in self.types()}

    def types(self) -> dict[str, np.dtype[Any]]:
        return {one.name: one.dtype for one in self.element.properties if one.count is None}

    def _fits(self, name: str, real: bool) -> bool:
        one = self.element.properties[self.place(name)[1]]
        return one.count is None and (one.dtype.kind == "f" or not real)

    def real(self, *names: str) -> bool:
        """Whether there are such properties, each of one real number."""
        return self.has(*names) and all(self._fits(name, real=True) for name in names)


def _names(stem: str, count: int) -> tuple[str, ...]:
    return tuple(f"{stem}{number}" for number in range(count))


def _scales(logarithms: Tensor) -> Tensor:
    """Scales (N, 3) of logarithms (N, 2 or 3)."""
    scales = logarithms.clamp_min(_SMALLEST_LOG).exp()
    if scales.shape[1] == 3:
        return scales
    return torch.cat([scales, THINNEST * scales.amin(dim=1, keepdim=True)], dim=1)


def _harmonics(vertices: _Vertices) -> Tensor:
    """Coefficients (N, K, 3) float32."""
    if not vertices.has(*_DC) and vertices.has(*_PAINT):
        vertices.demand(_PAINT, real=False)
        return ((vertices.read(_PAINT) / 255 - 0.5) / CONSTANT)[:, None].float()
    vertices.demand(_DC)
    rest = [one.name for one in vertices.element.properties if one.name.startswith("f_rest_")]
    count = 1 + len(rest) // 3
    degree = math.isqrt(count) - 1
    whole = {*_names("f_rest_", len(rest))} == {*rest}
    if len(rest) % 3 or (degree + 1) ** 2 != count or degree > HIGHEST_DEGREE or not whole:
        raise InputError(
            f"{vertices.where}: expected 0, 9, 24, 45 or 72 properties f_rest_0, f_rest_1, ... "
            f"(spherical harmonics of degree 0 to 4), got {len(rest)}; was the file cut by a tool?"
        )
    vertices.demand(tuple(rest))
    sh = torch.empty(vertices.element.length, count, 3)
    sh[:, 0] = vertices.read(_DC)
    for channel in range(3):
        for k in range(1, count):
            name = f"f_rest_{channel * (count - 1) + k - 1}"
            sh[:, k, channel] = vertices.read((name,)).squeeze(1)
    return sh


def _columns(gaussians: Gaussians, *, flat: bool) -> dict[str, NDArray[Any]]:
    """Values (N,) by the names of properties, in the order that INRIA's trainer writes."""
    own = gaussians.detached().to("cpu")
    columns = dict(zip(_PLACES, own.means.numpy().T, strict=True))
    columns |= dict(zip(_DC, own.sh[:, 0].numpy().T, strict=True))
    rest = own.sh[:, 1:].transpose(1, 2).flatten(start_dim=1).numpy()
    columns |= {f"f_rest_{k}": values for k, values in enumerate(rest.T)}
    columns["opacity"] = torch.logit(own.opacities.double(), eps=_SURE).numpy()
    logarithms = own.scales.double().log().numpy()[:, : 2 if flat else 3]
    columns |= {f"scale_{k}": values for k, values in enumerate(logarithms.T)}
    return columns | dict(zip(_QUAT, own.quats.numpy().T, strict=True))


def _told(file: SplatFile) -> tuple[str, ...]:
    """The comment that tells a footprint, as `_footprint` reads it."""
    own = file.footprint
    if own is None:
        return ()
    flags = f"antialiased={own.antialiased:d} flat={own.flat:d}"
    return (f"pcore footprint variance={own.variance:.9g} {flags}",)


def _footprint(ply: Ply, *, flat: bool) -> Footprint | None:
    """The footprint that a comment of the header tells; None without one that can be read."""
    for text in ply.header.comments:
        found = _COMMENT.fullmatch(text)
        if found is not None and 0 < float(found[1]) < math.inf:
            return Footprint(variance=float(found[1]), antialiased=found[2] == "1", flat=flat)
    return None
