"""Paint and light of models: pictures of every depth, mirrored parts, what is cut out."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from figure_model import bar, figure
from gltf_files import Builder
from PIL import Image

from pcore.benchmark.look import Look, Material, Texture, corner_normals
from pcore.benchmark.model import read_model
from pcore.benchmark.true_picture import Shape, take
from pcore.cli.main import main
from pcore.evaluation.ground_truth import load_truth
from pcore.evaluation.states import open_states
from pcore.sample.sample_render import ray_caster_class


def save(made: Builder, folder: Path) -> Path:
    path = folder / "figure.glb"
    path.write_bytes(made.content())
    return path


def test_what_is_cut_out_throws_no_shadow() -> None:
    """A plate over a floor that is all cut out, and one of which nothing is."""
    ray_caster_class()
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    places = np.concatenate([square, 0.5 * square + [0, 0, 0.4]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    pose = np.eye(4)
    pose[2, 3] = 4.0
    shots: dict[str, Any] = {"angle_x": 0.6, "resolution": 24}
    beside: list[int] = []
    for alpha in (0, 255):
        pixels = np.full((1, 1, 4), (255, 255, 255, alpha), np.uint8)
        look = Look(
            materials=(Material(), Material(texture=Texture(pixels=pixels), cutoff=0.5)),
            material_of_face=np.array([0, 0, 1, 1]),
            uv=(np.zeros((8, 2)),),
        )
        shape = Shape.of(places, faces, look)
        # The floor beside the plate, where its shadow lies.
        beside.append(int(take(shape, look, shape, pose, **shots).rgba[9, 5, 0]))
    bare = Look(materials=(Material(),), material_of_face=np.zeros(2, np.int64))
    floor = Shape.of(places[:4], faces[:2], bare)
    free = int(take(floor, bare, floor, pose, **shots).rgba[9, 5, 0])
    assert abs(beside[0] - free) <= 2  # Rays come in another order, with other draws of the lamps.
    assert beside[1] < free - 20


def test_depth_is_not_known_behind_what_is_cut_out(tmp_path: Path) -> None:
    """The upper half of the figure is painted with a picture of which the right half is clear."""
    tree = (cut := figure()).tree
    pixels = np.full((8, 8, 4), 255, np.uint8)
    pixels[:, 4:, 3] = 0
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG")
    tree["images"] = [{"bufferView": cut.view(np.frombuffer(buffer.getvalue(), np.uint8), "u1")}]
    tree["materials"][0]["alphaMode"] = "MASK"
    out = tmp_path / "out"
    words = ["--no-analytic", "--clips", "Bow", "--size", "40", "--train-views", "4"]
    words += ["--test-views", "3", "-o", str(out)]
    assert main(["benchmark", "make", str(save(cut, tmp_path)), *words]) == 0
    with np.load(out / "meshes.npz") as file:
        face, weights = file["sample_face"], file["sample_barycentric"]
        seen, clear = file["sample_visible"], file["cut_out"]
    model = read_model(tmp_path / "figure.glb")
    gone = model.look.rgba(model.faces, face, weights)[:, 3] < 0.5
    assert 0.3 < gone.mean() < 0.7
    assert not seen[gone].any()
    assert seen[~gone].any()
    assert clear[face[gone]].all()
    truth, state = load_truth(out), open_states(out).select(["bow"])[0]
    assert state.shots
    for shot in state.shots:
        depth = truth.depth("bow", shot.camera).numpy()
        with np.load(out / "bow" / "test_geometry" / f"{Path(shot.view.name).stem}.npz") as file:
            right = file["depth"]
        known = np.isfinite(depth)
        assert known.any()
        assert np.abs(depth[known] - right[known]).max() < 1e-4


def test_a_mirrored_half_is_shaded_as_the_other(tmp_path: Path) -> None:
    """A bar of two halves, the second of which is the first one mirrored at the plane x = 0."""
    place, _, faces = bar(sides=16)
    half = faces[(place[faces][..., 0] > -1e-9).all(axis=1)]
    made = Builder()
    normals = place * [1, 0, 1] / 0.2
    made.primitive["attributes"] = {"POSITION": made.array(place), "NORMAL": made.array(normals)}
    made.primitive["indices"] = made.array(half.ravel(), "u4")
    made.tree["nodes"].append({"mesh": 0, "scale": [-1, 1, 1]})
    made.tree["scenes"] = [{"nodes": [0, 1]}]
    model = read_model(save(made, tmp_path))
    shown = corner_normals(model.vertices, model.faces, model.look.smooth)
    out = model.vertices[model.faces] * [1, 1, 0]
    inner = np.abs(model.vertices[model.faces][..., 2] - 1) < 0.9
    out /= np.linalg.norm(out, axis=-1, keepdims=True)
    facing = (shown * out).sum(-1)[inner]
    assert len(model.faces) == 2 * len(half)
    # All outwards, or all inwards, as the triangles of the bar are.
    assert np.abs(facing).min() > 0.99
    assert len({*np.sign(facing)}) == 1


@pytest.mark.parametrize("kind", ["grey of 16 bits", "palette", "one bit", "grey and alpha"])
def test_textures_of_every_depth(tmp_path: Path, kind: str) -> None:
    """Dark left, bright right, by pixels of other kinds."""
    grey = np.full((4, 4), 64, np.uint8)
    grey[:, 2:] = 192
    pictures = {
        "grey of 16 bits": Image.fromarray(grey.astype(np.uint16) * 257),
        "palette": Image.fromarray(np.stack([grey] * 3, -1)).quantize(4),
        "one bit": Image.fromarray(grey > 100),
        "grey and alpha": Image.fromarray(np.stack([grey, np.full_like(grey, 255)], -1), "LA"),
    }
    buffer = io.BytesIO()
    pictures[kind].save(buffer, format="PNG")
    made = figure()
    image = made.view(np.frombuffer(buffer.getvalue(), np.uint8), "u1")
    made.tree["images"] = [{"bufferView": image}]
    texture = read_model(save(made, tmp_path)).look.materials[0].texture
    assert texture is not None
    expected = 255 * (grey > 100) if kind == "one bit" else grey
    assert np.array_equal(texture.pixels[..., :3], np.stack([expected] * 3, -1))
    assert (texture.pixels[..., 3] == 255).all()


def test_what_pictures_leave_out_is_said(tmp_path: Path) -> None:
    """A window whose alpha is below the half is no longer there, and a lamp is dark."""
    window, painted = figure(), figure()
    glass = {"baseColorFactor": [1, 1, 1, 0.4]}
    window.tree["materials"] = [
        {"pbrMetallicRoughness": glass, "alphaMode": "BLEND", "emissiveFactor": [0, 1, 0]},
        {"pbrMetallicRoughness": glass, "alphaMode": "BLEND"},  # Of no triangle.
    ]
    said = read_model(save(window, tmp_path)).look.left_out()
    assert [one.split(":")[0] for one in said] == [
        "what has the material 0 is not to be seen",
        "the material 0 shines by itself, which is left out",
    ]
    assert "its alpha 0.4 is below 0.5" in said[0]
    assert read_model(save(painted, tmp_path)).look.left_out() == []
