"""The Gaussians of a run, `gaussians.safetensors`: all that is needed to draw them as trained."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path

from torch import Tensor

from pcore.errors import CheckpointError, InputError
from pcore.files.headers import Companion
from pcore.files.provenance import Provenance
from pcore.files.records import from_dict, to_dict
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint
from pcore.geometry.surfels import of_unit_length

_FILE = Companion(
    noun="gaussians", version="1", mend="train them with `pcore train SCENE --model gaussians`"
)
GAUSSIANS_FILE = _FILE.name
_TENSORS = tuple(field.name for field in fields(Gaussians))
_NORMALS = "normals"


@dataclass(frozen=True, kw_only=True)
class SavedGaussians:
    """What the file holds; tensors on the CPU.

    Attributes:
        gaussians: at rest, world units.
        footprint: how they were trained to meet pixels.
        provenance: where they come from.
        normals: (N, 3) of the pieces of surface that they are, unit, outwards; zero where that is
            not known; None where nobody has estimated them.
    """

    gaussians: Gaussians
    footprint: Footprint
    provenance: Provenance
    normals: Tensor | None = None


def save_gaussians(path: Path, saved: SavedGaussians) -> None:
    """Write a file; a crash at any moment leaves the old file or the new one.

    Raises:
        OSError: the file cannot be written; the old one is untouched.
    """
    normals = {} if saved.normals is None else {_NORMALS: saved.normals}
    _FILE.write(
        path,
        {name: getattr(saved.gaussians, name) for name in _TENSORS} | normals,
        footprint=json.dumps(to_dict(saved.footprint)),
        provenance=json.dumps(to_dict(saved.provenance)),
    )


def load_gaussians(path: Path | str) -> SavedGaussians:
    """Read a file, given it or the run folder that holds it.

    Raises:
        CheckpointError: missing, damaged, not ours, of another version, or no Gaussians in it.
    """
    path = _FILE.path(path)
    header, tensors = _FILE.read(path)
    try:
        gaussians = Gaussians(**{name: tensors[name] for name in _TENSORS}).checked(str(path))
        # Older files say neither that they are flat nor how wide pixels were.
        read = {"flat": False, "pixel": None, **json.loads(header["footprint"])}
        footprint = from_dict(Footprint, read, where=f"{path}: footprint")
        provenance = from_dict(
            Provenance, json.loads(header["provenance"]), where=f"{path}: provenance"
        )
    except InputError as error:
        raise CheckpointError(str(error)) from error
    except (KeyError, ValueError) as error:
        raise CheckpointError(f"{path}: expected Gaussians of pcore, got {error}") from error
    return SavedGaussians(
        gaussians=gaussians,
        footprint=footprint,
        provenance=provenance,
        normals=_checked(path, tensors.get(_NORMALS), len(gaussians)),
    )


def _checked(path: Path, normals: Tensor | None, count: int) -> Tensor | None:
    """Return normals of so many Gaussians; CheckpointError where they cannot be that."""
    if normals is None:
        return None
    if tuple(normals.shape) != (count, 3):
        raise CheckpointError(
            f"{path}: expected normals ({count}, 3), got {tuple(normals.shape)}; {_FILE.mend}"
        )
    unknown = (normals == 0).all(dim=-1)
    if not bool((unknown | of_unit_length(normals)).all()):
        raise CheckpointError(
            f"{path}: expected normals of unit length, or zero where not known; {_FILE.mend}"
        )
    return normals


@dataclass(frozen=True, kw_only=True)
class GaussianSummary:
    """What such a file says about itself."""

    count: int
    degree: int
    footprint: Footprint
    provenance: Provenance


def describe_gaussians(path: Path | str) -> GaussianSummary:
    """Say what a file of Gaussians, or the one in a folder, holds; raises as `load_gaussians`."""
    saved = load_gaussians(path)
    return GaussianSummary(
        count=len(saved.gaussians),
        degree=saved.gaussians.degree,
        footprint=saved.footprint,
        provenance=saved.provenance,
    )
