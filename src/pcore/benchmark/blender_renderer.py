"""The pictures of a benchmark by Blender's Cycles, in a process of its own.

The process runs `in_blender.py` with a Python that has `bpy` and gets a folder of arrays, PNG
textures and one JSON file. Depth and normals are those of the embedded ray caster: Cycles mixes
both over a pixel.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from pcore.benchmark import in_blender
from pcore.benchmark.look import FloatArray, Look, Material
from pcore.benchmark.renderers import Job, Renderer
from pcore.benchmark.true_picture import GROUND, LAMPS, SKY, Shape, Shot, geometry_of
from pcore.errors import DependencyError, InputError

BPY_VARIABLE = "PCORE_BPY"
SAMPLES = 32
"""Paths of a pixel; Cycles denoises."""
_EXTENSIONS = {"repeat": "REPEAT", "mirror": "MIRROR", "clamp": "EXTEND"}


def blender_python() -> str:
    """A Python that has Blender: the one of PCORE_BPY, else this one.

    Raises:
        DependencyError: there is none.
    """
    given = os.environ.get(BPY_VARIABLE)
    if given:
        return given
    if importlib.util.find_spec("bpy") is None:
        raise DependencyError(
            "--renderer blender needs Blender as a Python module, which is missing: install "
            f'"pcore-edit[blender]" (Python 3.11), or set {BPY_VARIABLE} to a Python that imports '
            "bpy"
        )
    return sys.executable


def blender(look: Look, *, resolution: int, samples: int = SAMPLES) -> Renderer:
    """Cycles, with the sky and the lamps of the embedded renderer; light goes on from surfaces.

    Args:
        look: what is painted on the shapes.
        resolution: pixels along each side.
        samples: paths of a pixel.

    Raises:
        DependencyError: no Blender.
        InputError: a texture that repeats along one axis and not along the other.
    """
    python = blender_python()
    materials = [_material(number, one) for number, one in enumerate(look.materials)]

    def all_of(jobs: Sequence[Job]) -> Iterator[Shot]:
        with tempfile.TemporaryDirectory(prefix="pcore-blender-") as scratch:
            folder = Path(scratch)
            shapes = list(dict.fromkeys(job.shape for job in jobs))
            _write_paint(folder, look, shapes)
            about = {
                "resolution": resolution,
                "samples": samples,
                "sky": [GROUND, SKY],
                "lamps": [[*direction, *rest] for direction, *rest in LAMPS],
                "materials": materials,
                "shots": [
                    [shapes.index(job.shape), job.pose.tolist(), job.angle_x] for job in jobs
                ],
            }
            (folder / in_blender.JOB_FILE).write_text(json.dumps(about), encoding="utf-8")
            for number in _pictures(python, folder):
                job = jobs[number]
                depth, normal = geometry_of(job.shape, look, job.pose, job.angle_x, resolution)
                with Image.open(folder / f"{number}.png") as opened:
                    rgba = np.asarray(opened.convert("RGBA"))
                yield Shot(rgba=rgba, depth=depth, normal=normal)

    return all_of


def _material(number: int, material: Material) -> dict[str, Any]:
    texture, extension = material.texture, "REPEAT"
    if texture is not None:
        first, second = texture.wrap
        if first != second:
            raise InputError(
                f"material {number}: expected a texture that goes on alike along both axes for "
                f"Blender, got {first} and {second}; use the embedded renderer"
            )
        extension = _EXTENSIONS[first]
    return {
        "color": material.color,
        "cutoff": material.cutoff,
        "texture": texture is not None,
        "extension": extension,
    }


def _write_paint(folder: Path, look: Look, shapes: Sequence[Shape]) -> None:
    faces = shapes[0].caster.faces
    for number, material in enumerate(look.materials):
        if material.texture is not None:
            Image.fromarray(material.texture.pixels).save(folder / f"texture_{number}.png")
    arrays = {"faces": faces, "material": look.material_of_face, "uv": _corner_uv(look, faces)}
    if look.colors is not None:
        arrays["colors"] = look.colors
    np.savez(folder / in_blender.PAINT_FILE, allow_pickle=False, **arrays)
    for number, shape in enumerate(shapes):
        np.savez(
            folder / f"shape_{number}.npz",
            allow_pickle=False,
            vertices=shape.caster.vertices,
            corners=shape.corners,
        )


def _corner_uv(look: Look, faces: Any) -> FloatArray:
    """Places in the texture (F, 3, 2) of every corner, moved as its material says, v upwards."""
    found = np.zeros((len(faces), 3, 2))
    for number, material in enumerate(look.materials):
        here = look.material_of_face == number
        if material.texture is not None and here.any():
            uv = look.uv[material.texture.uv_set][faces[here]]
            found[here] = material.texture.moved(uv.reshape(-1, 2)).reshape(uv.shape)
    found[..., 1] = 1.0 - found[..., 1]
    return found


def _pictures(python: str, folder: Path) -> Iterator[int]:
    """Numbers of the pictures as they come.

    Raises:
        DependencyError: Blender cannot be started, or ended early.
    """
    log = folder / "log.txt"
    command = [python, "-I", str(Path(in_blender.__file__)), str(folder)]
    with log.open("w", encoding="utf-8") as errors:
        try:
            process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True)
        except OSError as error:
            raise DependencyError(
                f"{BPY_VARIABLE}={python}: expected a Python that imports bpy, got: {error}"
            ) from error
        assert process.stdout is not None
        try:
            for line in process.stdout:
                # Blender itself prints too.
                if line.startswith(in_blender.DONE):
                    yield int(line.removeprefix(in_blender.DONE))
            ended = process.wait()
        finally:
            process.kill()
            process.wait()
            process.stdout.close()
    if ended != 0:
        told = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        raise DependencyError(
            f"{python}: expected Blender to take all pictures, it ended with code {ended}: "
            f"{told[-1] if told else 'it said nothing'}; try `{python} -c 'import bpy'`"
        )
