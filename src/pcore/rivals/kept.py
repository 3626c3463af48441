"""Trainings of rivals that are kept on the disk, with what they cost."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TypeVar

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from pcore.errors import InputError
from pcore.files.atomic import write_atomically
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint
from pcore.rivals.bound_fit import BoundGaussians
from pcore.rivals.voxels import VoxelField, VoxelGrid

Made = TypeVar("Made")


@dataclass(frozen=True, kw_only=True)
class Spent:
    """What a training took: seconds of the processor, and the most memory, MB (None: unknown)."""

    seconds: float
    megabytes: float | None


def kept_cost(path: Path, train: Callable[[], Made]) -> tuple[Made, Spent | None]:
    """Train, and remember the cost in a file; None where nobody knows it.

    Args:
        path: of the file with the cost.
        train: reads a finished training.
    """
    if path.is_file():
        return train(), _read_cost(path)
    begin = time.process_time()
    _reset_peak()
    made = train()
    spent = Spent(seconds=time.process_time() - begin, megabytes=_peak())
    record = {"seconds": spent.seconds, "megabytes": spent.megabytes}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(record).encode())
    return made, spent


def _read_cost(path: Path) -> Spent | None:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        return Spent(seconds=float(record["seconds"]), megabytes=record["megabytes"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _reset_peak() -> None:
    """Forget the peak of memory so far, where the system can (Linux)."""
    if sys.platform == "linux":
        try:
            Path("/proc/self/clear_refs").write_text("5")
        except OSError:
            return


def _peak() -> float | None:
    """The most memory since then, MB; None where the system does not tell."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return None
    found = [line.split()[1] for line in lines if line.startswith("VmHWM:")]
    return float(found[0]) / 1024 if found else None


def kept_bound(path: Path, train: Callable[[], BoundGaussians]) -> BoundGaussians:
    """Read Gaussians on a mesh, or train and write them."""
    known = read_tensors(path)
    if known is None:
        made = train()
        named = {f.name: getattr(made.gaussians, f.name) for f in fields(Gaussians)}
        shape = torch.tensor([made.footprint.variance, float(made.footprint.antialiased)])
        mesh = {"vertices": made.vertices, "faces": made.faces, "footprint": shape}
        write_tensors(path, {**named, **mesh})
        return made
    variance, antialiased = known["footprint"].double().tolist()
    return BoundGaussians(
        vertices=known["vertices"],
        faces=known["faces"],
        gaussians=Gaussians(**{f.name: known[f.name] for f in fields(Gaussians)}),
        footprint=Footprint(variance=variance, antialiased=bool(antialiased)),
    )


def kept_voxels(path: Path, train: Callable[[], VoxelField]) -> VoxelField:
    """Read a voxel field, or train and write it."""
    known = read_tensors(path)
    if known is None:
        made = train()
        grid = made.grid
        step = torch.tensor([grid.step], dtype=torch.float64)
        parts = {"index": grid.index, "lower": grid.lower, "step": step}
        write_tensors(path, {**parts, "values": made.values})
        return made
    grid = VoxelGrid(index=known["index"], lower=known["lower"], step=float(known["step"]))
    return VoxelField(grid=grid, values=known["values"])


def kept_mesh(
    path: Path, make: Callable[[], tuple[Tensor, Tensor, Tensor, Tensor]]
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Read a mesh (vertices, faces) and its cage (vertices, faces), or make and write them."""
    names = ("vertices", "faces", "cage_vertices", "cage_faces")
    known = read_tensors(path)
    if known is None:
        made = make()
        write_tensors(path, dict(zip(names, made, strict=True)))
        return made
    first, second, third, fourth = (known[name] for name in names)
    return first, second, third, fourth


def read_tensors(path: Path) -> dict[str, Tensor] | None:
    """Read tensors by name; None where there is no file.

    Raises:
        InputError: it is damaged.
    """
    if not path.is_file():
        return None
    try:
        return load_file(path)
    except (OSError, SafetensorError) as error:
        raise InputError(
            f"{path}: expected a training that was kept, got a file that is cut short or damaged "
            f"({error}); delete it, and it is trained again"
        ) from error


def write_tensors(path: Path, tensors: Mapping[str, Tensor]) -> None:
    """Write tensors by name, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, save({name: t.contiguous() for name, t in tensors.items()}))
