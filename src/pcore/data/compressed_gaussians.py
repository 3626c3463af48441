"""Compressed files of Gaussians: SuperSplat's compressed PLY, SPZ and SOG.

They are decoded by the package gaussforge (extra "splats"), in a process of its own.
"""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pcore.data import gaussian_decoder
from pcore.data.gaussian_ply import read_gaussian_ply
from pcore.data.ply import parse_ply
from pcore.data.splat_file import SplatFile, sound
from pcore.errors import DependencyError, InputError
from pcore.gaussians.gaussians import Gaussians

NAMES = {"compressed.ply": "SuperSplat's compressed PLY", "spz": "SPZ", "sog": "SOG"}
_END = b"end_header\n"
_COLOR_RANGES = (b"min_r", b"min_g", b"min_b", b"max_r", b"max_g", b"max_b")
_PATIENCE = 600.0
"""Seconds; a million Gaussians take one or two."""


def read_compressed(content: bytes, kind: str, where: str) -> SplatFile:
    """Read a compressed file of Gaussians.

    Args:
        content: the file.
        kind: one of `NAMES`.
        where: its name, for messages.

    Raises:
        DependencyError: the package that decodes it is missing.
        InputError: it is damaged; or see `sound`.
    """
    if importlib.util.find_spec("gaussforge") is None:
        raise DependencyError(
            f"{where}: {NAMES[kind]} needs the package gaussforge: pip install "
            "'pcore-edit[splats]'; or export the splats as an uncompressed PLY, which SuperSplat "
            "does, and `splat-transform`"
        )
    if kind == "compressed.ply":
        content = _completed(content)
    head, values = _decoded(content, kind, where)
    if "ply" in values:
        try:
            ply = parse_ply(values["ply"].tobytes(), where)
        except InputError:
            raise _damaged(kind, where, "the decoder broke off") from None
        return read_gaussian_ply(ply, where)
    count, degree = int(head["count"]), int(head["degree"])
    harmonics = values["sh"].reshape(count, -1, 3)[:, : (degree + 1) ** 2 - 1]
    with np.errstate(invalid="ignore"):
        wide = {name: torch.from_numpy(value.astype(np.float64)) for name, value in values.items()}
    quats = wide["rotations"].reshape(count, 4)
    gaussians = Gaussians(
        means=wide["positions"].reshape(count, 3),
        quats=quats / quats.norm(dim=1, keepdim=True),
        scales=wide["scales"].reshape(count, 3).exp(),
        opacities=wide["alphas"].sigmoid(),
        sh=torch.from_numpy(
            np.concatenate([values["colors"].reshape(count, 1, 3), harmonics], axis=1)
        ),
    )
    numbers = np.arange(count, dtype=np.int64)
    return sound(SplatFile(gaussians=gaussians, where=where, rows=numbers))


def _completed(content: bytes) -> bytes:
    """Add ranges of colours, which the decoder wants; files without them have colours of 0 to 1."""
    head, end, body = content.partition(_END)
    chunks = re.search(rb"element chunk (\d{1,9})\s", head)
    if not end or chunks is None:
        return content
    number = int(chunks[1])
    if b" min_r" not in head and len(body) >= number * 48:
        lines = b"".join(b"property float %s\n" % name for name in _COLOR_RANGES)
        head = head.replace(b"element vertex ", lines + b"element vertex ", 1)
        rows = np.frombuffer(body, dtype="<f4", count=number * 12).reshape(number, 12)
        colors = np.tile(np.array([0, 0, 0, 1, 1, 1], dtype="<f4"), (number, 1))
        body = np.concatenate([rows, colors], axis=1).tobytes() + body[number * 48 :]
    return head + end + body


def _decoded(
    content: bytes, kind: str, where: str
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Run the decoder; its head and arrays, whose sizes fit each other."""
    program = [sys.executable, str(Path(gaussian_decoder.__file__)), kind]
    try:
        done = subprocess.run(program, input=content, capture_output=True, timeout=_PATIENCE)
    except subprocess.TimeoutExpired:
        raise _damaged(kind, where, "the decoder did not end") from None
    line, _, body = done.stdout.partition(b"\n")
    if done.returncode or not line:
        raise _damaged(kind, where, "the decoder broke off")
    head: dict[str, Any] = json.loads(line)
    if "error" in head:
        raise _damaged(kind, where, head["error"])
    if "ply" in head:
        return head, {"ply": np.frombuffer(body, dtype=np.uint8)}
    arrays: dict[str, NDArray[Any]] = {}
    place = 0
    for name, size in head["sizes"].items():
        arrays[name] = np.frombuffer(body, dtype="<f4", count=size // 4, offset=place)
        place += size
    n = int(head["count"])
    wanted = {"positions": 3 * n, "scales": 3 * n, "rotations": 4 * n, "alphas": n, "colors": 3 * n}
    rest = 3 * n * ((int(head["degree"]) + 1) ** 2 - 1)
    if any(arrays[name].size != size for name, size in wanted.items()) or arrays["sh"].size < rest:
        raise _damaged(kind, where, "numbers are missing")
    return head, arrays


def _damaged(kind: str, where: str, why: str) -> InputError:
    return InputError(
        f"{where}: expected Gaussians as {NAMES[kind]}, got a file that is damaged or holds "
        f"something else ({why}); export the splats as an uncompressed PLY"
    )
