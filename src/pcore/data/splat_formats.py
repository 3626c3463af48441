"""Files of Gaussians by their endings: .ply, .splat, .spz, .sog in; .ply, .splat, .glb out."""

from __future__ import annotations

from pathlib import Path

from pcore.data.compressed_gaussians import read_compressed
from pcore.data.gaussian_glb import HIGHEST_DEGREE, glb_content
from pcore.data.gaussian_ply import gaussian_ply, is_gaussian, lost, read_gaussian_ply
from pcore.data.gaussian_splat import read_splat, splat_content
from pcore.data.ply import Ply, parse_ply
from pcore.data.ply_header import read_header
from pcore.data.splat_file import SplatFile
from pcore.data.whole_file import write_whole
from pcore.errors import InputError
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
    ply = Ply(header=header, content=b"", rows=())
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
