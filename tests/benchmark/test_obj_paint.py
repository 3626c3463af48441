"""The paint of an OBJ: several libraries, names with spaces, tiles, colours of vertices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pcore.benchmark.model import Model, read_model
from pcore.cli.info_rows import rows_of
from pcore.errors import InputError

RED, GREEN, BLUE, WHITE = (220, 0, 0), (0, 220, 0), (0, 0, 220), (255, 255, 255)
CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))


@pytest.fixture
def kit(tmp_path: Path) -> Path:
    """A folder with a picture (red above, blue below) and two libraries."""
    halves = np.array([[RED]] * 8 + [[BLUE]] * 8, np.uint8)
    Image.fromarray(halves).save(tmp_path / "two halves.png")
    (tmp_path / "textures").mkdir()
    Image.fromarray(np.array([[GREEN]], np.uint8)).save(tmp_path / "textures" / "green.png")
    (tmp_path / "my paint.mtl").write_text(
        "newmtl dark red\nKd 0.2158605 0 0\nnewmtl halves\nKd 0.8 0.8 0.8\nmap_Kd two halves.png\n"
    )
    (tmp_path / "more.mtl").write_bytes(
        b"newmtl green\r\nmap_Kd C:\\art\\textures\\green.png\r\n"
        b"newmtl low\r\nmap_Kd -s 1 0.5 -o 0 0 0 two halves.png\r\n"
    )
    (tmp_path / "green.png").write_bytes((tmp_path / "textures" / "green.png").read_bytes())
    return tmp_path


def quads(*materials: str, tiles: float = 1, relative: bool = False) -> str:
    """A square of each material, beside one another; texture coordinates up to `tiles`."""
    lines: list[str] = []
    for number, name in enumerate(materials):
        lines += [f"v {x + 2 * number} {y} {0.1 * x}" for x, y in CORNERS]
        lines += [f"vt {tiles * x} {tiles * y}" for x, y in CORNERS]
        first = -4 if relative else 4 * number + 1
        lines += [f"usemtl {name}", "f " + " ".join(f"{k}/{k}" for k in range(first, first + 4))]
    return "\n".join(lines) + "\n"


def read(folder: Path, text: str) -> Model:
    (folder / "a model.obj").write_text(text)
    return read_model(folder / "a model.obj")


def color(model: Model, square: int, x: float, y: float) -> list[int]:
    """Bytes of sRGB at a place (x, y) of a square."""
    at = model.vertices[model.faces][2 * square : 2 * square + 2][..., [0, 2]]
    for face, corners in enumerate(at, start=2 * square):
        spans = np.column_stack([corners, np.ones(3)])
        weights = np.linalg.solve(spans.T, [x + 2 * square, y, 1])
        if (weights > -1e-9).all():
            rgba = model.look.rgba(model.faces, np.array([face]), weights[None])[0]
            light = np.where(
                rgba <= 0.0031308, 12.92 * rgba, 1.055 * rgba.clip(1e-9) ** (1 / 2.4) - 0.055
            )
            return np.rint(255 * light[:3]).astype(int).tolist()
    raise AssertionError("no such place")


@pytest.mark.parametrize(
    "libraries",
    [
        "mtllib my paint.mtl\nmtllib more.mtl\n",
        "mtllib more.mtl\no first\nmtllib my paint.mtl\n",
        "mtllib my_paint.mtl more.mtl\n",
    ],
)
@pytest.mark.parametrize("relative", [False, True])
def test_every_face_has_the_paint_of_its_material(
    kit: Path, libraries: str, relative: bool
) -> None:
    (kit / "my_paint.mtl").write_bytes((kit / "my paint.mtl").read_bytes())
    text = libraries + quads("dark red", "halves", "green", "low", relative=relative)
    model = read(kit, text)
    assert model.vertices[:, 0].max() == 7
    assert color(model, 0, 0.5, 0.5) == [55, 0, 0]
    # v points up; the picture's colours are those of the file, whatever `Kd` says.
    assert color(model, 1, 0.5, 0.875) == [220, 0, 0]
    assert color(model, 1, 0.5, 0.125) == [0, 0, 220]
    assert color(model, 2, 0.3, 0.7) == [0, 220, 0]
    # Half of the picture, from v = 0: the lower one.
    assert color(model, 3, 0.5, 0.6) == [0, 0, 220]


def test_tiles_go_on_within_a_face(kit: Path) -> None:
    model = read(kit, "mtllib my paint.mtl\n" + quads("halves", tiles=3))
    heights = [0.125 / 3, 0.875 / 3, 1.125 / 3, 1.875 / 3, 2.125 / 3, 2.875 / 3]
    assert [color(model, 0, 0.5, y) for y in heights] == [[0, 0, 220], [220, 0, 0]] * 3


def test_colours_behind_vertices_paint_faces_without_a_material(kit: Path) -> None:
    text = "mtllib my paint.mtl\n" + quads("unknown", "dark red")
    lines = [f"{line} 0 1 0" if line.startswith("v ") else line for line in text.splitlines()]
    model = read(kit, "\n".join(lines))
    assert color(model, 0, 0.5, 0.5) == [0, 255, 0]
    assert color(model, 1, 0.5, 0.5) == [55, 0, 0]


def test_comments_behind_names_and_colours(kit: Path) -> None:
    (kit / "said.mtl").write_text(
        "newmtl a # painted\nKd 1 0 0 # red\nnewmtl Material #25\nKd 0 1 0\n"
        "newmtl Material #26\nKd 0 0 1\nnewmtl b\nKd 1 1 1\n"
    )
    names = ("a # body", "Material #25", "Material #26", "b #hand", "(null)")
    model = read(kit, "mtllib said.mtl\n" + quads(*names))
    expected = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]]
    assert [color(model, square, 0.5, 0.5) for square in range(4)] == expected


def test_materials_that_no_face_uses_are_not_counted(kit: Path) -> None:
    read(kit, "mtllib my paint.mtl\nusemtl halves\n" + quads("dark red"))
    told = dict(rows_of(kit / "a model.obj", settings=False))
    assert told["materials"] == "1, 0 with a texture"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "mtllib more.mtl\n" + quads("green", "skin", "Material #27"),
            "expected materials of its libraries, got skin, Material #27; export it again with",
        ),
        ("mtllib gone away.mtl\n" + quads("a"), "missing: gone away.mtl; bring them"),
        ("mtllib bad.mtl\n" + quads("a"), r"expected three numbers of a colour \(Kd\), got '1 x'"),
        ("mtllib torn.mtl\n" + quads("a"), "expected a texture in PNG, JPEG or WebP"),
        ("mtllib bad.mtl gone.mtl\n" + quads("b"), "missing: gone.mtl; bring them"),
        (quads("a").replace("f 1/1", "f 1/9"), "expected faces that refer to vt 1 to 4, got 9"),
        (quads("a").replace("vt 0 0", "vt 0 nan"), "expected finite texture coordinates, got NaN"),
        (quads("a").replace("vt 0 0", "vt 0 a"), "line 5: expected the numbers of a texture"),
    ],
)
def test_paint_that_is_damaged_is_named(kit: Path, text: str, said: str) -> None:
    (kit / "bad.mtl").write_text("newmtl a\nKd 1 x\n" if "usemtl a" in text else "newmtl b\n")
    (kit / "torn.mtl").write_text("newmtl a\nmap_Kd torn.png\n")
    (kit / "torn.png").write_bytes((kit / "green.png").read_bytes()[:40])
    with pytest.raises(InputError, match=said):
        read(kit, text)
