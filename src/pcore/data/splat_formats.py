"""Files of Gaussians by their endings: .ply, .splat, .spz, .sog in; .ply, .splat, .glb out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from pcore.data.compressed_gaussians import read_compressed
from pcore.data.gaussian_ply import CONSTANT, gaussian_ply, is_gaussian, lost, read_gaussian_ply
from pcore.data.gltf_writer import VERTICES, GltfWriter
from pcore.data.ply import Ply, parse_ply
from pcore.data.ply_binary import Binary
from pcore.data.ply_header import read_header
from pcore.data.splat_file import SplatFile, sound
from pcore.data.whole_file import write_whole
from pcore.errors import InputError
from pcore.gaussians.carry import carried
from pcore.gaussians.gaussians import Gaussians
from pcore.validation import read_bytes

OUTPUTS = (".ply", ".splat", ".glb")
_OTHERS = (".splat", ".spz", ".sog", ".ksplat")
"""Endings of files that hold Gaussians and nothing else."""


def holds_splats(path: Path | str) -> bool:
    """Whether a file holds Gaussians, by its ending, or the header of a `.ply`.

    False for a file that is missing or damaged, so that who reads it next says so.
    """
    path = Path(path)
    if path.suffix.lower() != ".ply":
        return path.suffix.lower() in _OTHERS
    try:
        with path.open("rb") as file:
            header = read_header(file.read(1 << 16), str(path))
    except (OSError, InputError):
        return False
    nothing = Binary(content=b"", start=0)
    ply = Ply(header=header, source=nothing, rows=(), where=str(path))
    return _is_compressed(ply) or is_gaussian(ply)


def read_splats(path: Path | str) -> SplatFile:
    """Read a file of Gaussians.

    Args:
        path: a `.ply` of INRIA, gsplat, nerfstudio, 2DGS or SuperSplat (compressed, too), a
            `.splat`, `.spz` or `.sog`.

    Raises:
        InputError: missing, damaged or cut short; of another kind; numbers that are not of
            Gaussians.
        DependencyError: a compressed file, and the package that decodes it is missing.
    """
    path = Path(path)
    kind, where = path.suffix.lower(), str(path)
    if kind == ".ksplat":
        raise InputError(
            f"{where}: .ksplat files are not read: export the splats as .ply or .splat, which "
            "SuperSplat and `splat-transform` do"
        )
    if kind not in (".ply", *_OTHERS):
        raise InputError(
            f"{where}: expected Gaussians in a file that ends in .ply, .splat, .spz or .sog, got "
            f"{path.suffix or 'no ending'!r}"
        )
    content = read_bytes(path, what="a file of Gaussians")
    if kind == ".splat":
        return read_splat(content, where)
    if kind != ".ply":
        return read_compressed(content, kind[1:], where)
    ply = parse_ply(content, where)
    if _is_compressed(ply):
        return read_compressed(content, "compressed.ply", where)
    if not is_gaussian(ply):
        raise InputError(
            f"{where}: expected the PLY of a 3DGS trainer (f_dc_0, opacity, scale_0, rot_0, ...), "
            "got other properties; a file of bare points has no Gaussians"
        )
    return read_gaussian_ply(ply, where)


def save_splats(path: Path | str, file: SplatFile) -> tuple[str, ...]:
    """Write Gaussians; replaces the file at once.

    Args:
        path: where to; `.ply` keeps all that a PLY held, `.splat` has colours of degree 0 only,
            `.glb` is glTF with KHR_gaussian_splatting. The folder must exist.
        file: what to write.

    Returns:
        What the written file does not hold, for the user.

    Raises:
        InputError: another ending, or a place that is not writable.
    """
    path = Path(path)
    check_splat_output(path)
    kind, degree = path.suffix.lower(), file.gaussians.degree
    notes: list[str] = []
    if kind == ".ply":
        content = gaussian_ply(file)
        notes += [f"not written: {what}" for what in lost(file)]
    elif kind == ".splat":
        content = splat_content(file.gaussians)
        if degree:
            notes.append(
                "a .splat file has one colour for each Gaussian: how it changes with the view "
                f"(degree 1 to {degree}) is not written, and quaternions have 8 bits"
            )
    else:
        content = glb_content(file.gaussians)
        if degree > HIGHEST_DEGREE:
            notes.append(f"glTF knows degree 0 to 3: degree {degree} is not written")
    write_whole(path, content, "Gaussians")
    return tuple(notes)


def check_splat_output(path: Path) -> None:
    """Raise InputError unless Gaussians can be written to a file of this name."""
    if path.suffix.lower() not in OUTPUTS:
        raise InputError(
            f"{path}: expected a file of Gaussians that ends in .ply, .splat or .glb, got "
            f"{path.suffix or 'no ending'!r}; compress it afterwards with SuperSplat or "
            "`splat-transform`"
        )


def _is_compressed(ply: Ply) -> bool:
    return ply.header.find("chunk") is not None


_ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("paint", "u1", 4), ("quats", "u1", 4)])
_SMALLEST = 1e-20


def read_splat(content: bytes, where: str) -> SplatFile:
    """Read the Gaussians of a `.splat` file.

    Args:
        content: the file.
        where: its name, for messages.

    Raises:
        InputError: no Gaussians, half ones, or see `sound`.
    """
    if not content or len(content) % _ROW.itemsize:
        raise InputError(
            f"{where}: expected 32 bytes for each Gaussian of a .splat file, got {len(content):,} "
            "bytes, which is no multiple; the file is cut short or of another kind"
        )
    rows = np.frombuffer(content, dtype=_ROW)
    with np.errstate(invalid="ignore"):
        means, scales = (torch.from_numpy(rows[k].astype(np.float64)) for k in ("means", "scales"))
    quats = torch.from_numpy((rows["quats"].astype(np.float64) - 128) / 128)
    paint = torch.from_numpy(rows["paint"].astype(np.float64) / 255)
    gaussians = Gaussians(
        means=means,
        quats=quats / quats.norm(dim=1, keepdim=True),
        scales=scales.clamp_min(_SMALLEST),
        opacities=paint[:, 3],
        sh=((paint[:, None, :3] - 0.5) / CONSTANT).float(),
    )
    numbers = np.arange(len(gaussians), dtype=np.int64)
    return sound(SplatFile(gaussians=gaussians, where=where, rows=numbers))


def splat_content(gaussians: Gaussians) -> bytes:
    """Content of a `.splat` file; colours are those of degree 0, and quaternions have 8 bits."""
    own = gaussians.detached().to("cpu", torch.float64)
    rows = np.empty(len(own), dtype=_ROW)
    rows["means"], rows["scales"] = own.means.numpy(), own.scales.numpy()
    shade = torch.cat([0.5 + CONSTANT * own.sh[:, 0], own.opacities[:, None]], dim=1)
    rows["paint"] = (shade * 255).round().clamp(0, 255).numpy()
    rows["quats"] = (own.quats * 128 + 128).round().clamp(0, 255).numpy()
    return rows.tobytes()


HIGHEST_DEGREE = 3
"""Of the harmonics that the extension knows."""

_EXTENSION = "KHR_gaussian_splatting"
_POINTS = 0
_UP = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))
"""From z up to y up."""


def glb_content(gaussians: Gaussians) -> bytes:
    """Content of a `.glb` file of Gaussians (z up); degrees above 3 are left out."""
    attributes = _attributes(_turned(gaussians.detached().to("cpu", torch.float64)))
    writer = GltfWriter()
    numbers = {
        name: writer.add(values, target=VERTICES, bounds=name == "POSITION")
        for name, values in attributes.items()
    }
    primitive = {
        "mode": _POINTS,
        "attributes": numbers,
        "extensions": {_EXTENSION: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}},
    }
    return writer.content(
        {
            "extensionsUsed": [_EXTENSION],
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [primitive]}],
        }
    )


def _turned(gaussians: Gaussians) -> Gaussians:
    up = torch.tensor(_UP, dtype=torch.float64)
    return carried(gaussians, gaussians.means @ up.T, up.expand(len(gaussians), 3, 3))


def _attributes(own: Gaussians) -> dict[str, NDArray[np.float64]]:
    paint = (0.5 + CONSTANT * own.sh[:, 0]).clamp(0, 1)
    result = {
        "POSITION": own.means,
        # What viewers show that know points but no Gaussians.
        "COLOR_0": torch.cat([paint, own.opacities[:, None]], dim=1),
        f"{_EXTENSION}:ROTATION": own.quats.roll(-1, dims=1),
        f"{_EXTENSION}:SCALE": own.scales,
        f"{_EXTENSION}:OPACITY": own.opacities,
    }
    for degree in range(min(own.degree, HIGHEST_DEGREE) + 1):
        for k in range(2 * degree + 1):
            name = f"{_EXTENSION}:SH_DEGREE_{degree}_COEF_{k}"
            result[name] = own.sh[:, degree * degree + k]
    return {name: tensor.numpy() for name, tensor in result.items()}
