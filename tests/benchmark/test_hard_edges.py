"""Normals of models that are no glTF: what the file says is hard stays hard."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from pcore.benchmark.look import corner_normals, mesh_normals
from pcore.benchmark.model import Model, read_model

PLACES = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
SIDES = (
    ((0, 1, 3, 2), (-1, 0, 0)),
    ((4, 6, 7, 5), (1, 0, 0)),
    ((0, 4, 5, 1), (0, -1, 0)),
    ((2, 3, 7, 6), (0, 1, 0)),
    ((0, 2, 6, 4), (0, 0, -1)),
    ((1, 5, 7, 3), (0, 0, 1)),
)


def cube(*, normals: bool = True, smooth: str = "") -> str:
    """An OBJ of eight vertices whose sides have hard edges by `vn` or by `s off`."""
    lines = [f"v {x} {y} {z}" for x, y, z in PLACES]
    lines += [f"vn {x} {y} {z}" for _, (x, y, z) in SIDES] if normals else []
    lines += [f"s {smooth}"] if smooth else []
    for number, (side, _) in enumerate(SIDES, start=1):
        end = f"//{number}" if normals else ""
        lines.append("f " + " ".join(f"{k + 1}{end}" for k in side))
    return "\n".join(lines) + "\n"


def degrees(model: Model) -> float:
    """Largest angle between the normals at corners and those of their faces."""
    shown = corner_normals(model.vertices, model.faces, model.look.smooth)
    flat = mesh_normals(model.vertices, model.faces)
    cosine = np.einsum("fkc,fc->fk", shown, flat)
    return float(np.degrees(np.arccos(cosine.clip(-1, 1))).max())


@pytest.mark.parametrize(
    ("text", "hard"),
    [
        (cube(), True),
        (cube(smooth="off"), True),
        (cube(normals=False, smooth="off"), True),
        (cube(normals=False, smooth="0"), True),
        (cube(normals=False), False),
        (cube(normals=False, smooth="1"), False),
    ],
)
def test_hard_edges_of_an_obj(tmp_path: Path, text: str, *, hard: bool) -> None:
    (tmp_path / "cube.obj").write_text(text)
    model = read_model(tmp_path / "cube.obj")
    assert len(model.faces) == 12
    assert degrees(model) == pytest.approx(0, abs=0.01) if hard else degrees(model) > 30


def test_parts_of_an_obj_keep_their_normals(tmp_path: Path) -> None:
    half = cube().replace("f 1//", "usemtl a\nf 1//", 1).replace("f 3//4", "usemtl b\nf 3//4", 1)
    (tmp_path / "two.mtl").write_text("newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 0 1\n")
    (tmp_path / "two.obj").write_text("mtllib two.mtl\n" + half)
    model = read_model(tmp_path / "two.obj")
    assert len(model.faces) == 12
    assert degrees(model) == pytest.approx(0, abs=0.01)


def test_hard_edges_of_a_ply(tmp_path: Path) -> None:
    places = [PLACES[k] for side, _ in SIDES for k in side]
    normals = [normal for side, normal in SIDES for _ in side]
    head = ["ply", "format ascii 1.0", "element vertex 24"]
    head += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    head += ["element face 6", "property list uchar int vertex_indices", "end_header"]
    rows = [" ".join(map(str, (*p, *n))) for p, n in zip(places, normals, strict=True)]
    faces = [f"4 {4 * k} {4 * k + 1} {4 * k + 2} {4 * k + 3}" for k in range(6)]
    (tmp_path / "cube.ply").write_text("\n".join([*head, *rows, *faces]) + "\n")
    assert degrees(read_model(tmp_path / "cube.ply")) == pytest.approx(0, abs=0.01)
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.vertex_normals  # noqa: B018 - makes the exporter write them
    (tmp_path / "ball.ply").write_bytes(ball.export(file_type="ply", vertex_normal=True))
    model = read_model(tmp_path / "ball.ply")
    shown = corner_normals(model.vertices, model.faces, model.look.smooth)
    assert np.einsum("fkc,fkc->fk", shown, model.vertices[model.faces]).min() > 0.99
