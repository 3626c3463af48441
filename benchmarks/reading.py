"""Processor seconds that files of a million points or triangles take to read and to write.

python -m benchmarks.reading [--points 1000000]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pcore.data.meshes import read_mesh
from pcore.data.points import read_point_file, save_moved


def header(encoding: str, points: int, properties: list[str], faces: int = 0) -> bytes:
    """Header of a PLY file of real numbers and faces."""
    lines = ["ply", f"format {encoding} 1.0", f"element vertex {points}"]
    lines += [f"property float {name}" for name in properties]
    if faces:
        lines += [f"element face {faces}", "property list uchar int vertex_indices"]
    return "\n".join([*lines, "end_header", ""]).encode()


def timed(what: str, action: Callable[[], object]) -> None:
    """Print what an action costs."""
    begin = time.process_time()
    action()
    print(f"{what}: {time.process_time() - begin:.2f} s")


def main() -> None:
    """Make the files in a folder of their own, read and write them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--points", type=int, default=1_000_000)
    points = parser.parse_args().points
    generator = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        splats = generator.random((points, 62), dtype=np.float32)
        names = [*"xyz", *(f"p{k}" for k in range(59))]
        binary = header("binary_little_endian", points, names) + splats.tobytes()
        (folder / "splats.ply").write_bytes(binary)
        few = splats[:, :3]
        rows = "\n".join(" ".join(map(str, row)) for row in few.tolist())
        text = header("ascii", points, ["x", "y", "z"]) + rows.encode()
        (folder / "text.ply").write_bytes(text)
        sizes = np.array([3, 4])[np.arange(points) % 2]
        faces = b"".join(
            bytes([size]) + generator.integers(0, points, size, dtype=np.int32).tobytes()
            for size in sizes.tolist()
        )
        mesh = header("binary_little_endian", points, ["x", "y", "z"], points)
        (folder / "mixed.ply").write_bytes(mesh + few.tobytes() + faces)
        for file, what in (("splats.ply", "62 properties, binary"), ("text.ply", "3, text")):
            found = read_point_file(folder / file)
            timed(f"read {points:,} points of {what}", lambda f=file: read_point_file(folder / f))
            timed(
                "  written with moved points",
                lambda one=found: save_moved(folder / "out.ply", one, one.positions + 1),
            )
        timed(f"read {points:,} triangles and quads", lambda: read_mesh(folder / "mixed.ply"))


if __name__ == "__main__":
    main()
