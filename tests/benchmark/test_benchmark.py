"""`pcore benchmark make`: exact maps, true pictures, and models that are refused."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from figure_model import TURN, bar, bowed, figure, picture
from gltf_files import Builder
from PIL import Image

import pcore
from pcore.benchmark.look import Look, Material, Texture, corner_normals, smooth_patches
from pcore.benchmark.model import read_model
from pcore.benchmark.true_picture import Shape, take
from pcore.capture.load import load_state
from pcore.cli.main import main
from pcore.data.gltf_animation import Track, value_at
from pcore.errors import InputError
from pcore.evaluation.ground_truth import load_truth
from pcore.evaluation.states import open_states
from pcore.sample.sample_render import camera_poses, ray_caster_class

SIZE, VIEWS = 40, 3
STATE_VIEWS = ("--state-train-views", 2)


def z_up(place: np.ndarray) -> np.ndarray:
    return np.stack([place[:, 0], -place[:, 2], place[:, 1]], axis=1)


def save(made: Builder, folder: Path, name: str = "figure") -> Path:
    path = folder / f"{name}.glb"
    path.write_bytes(made.content())
    return path


def make(*words: object) -> int:
    sizes = ["--size", SIZE, "--train-views", 4, "--test-views", VIEWS]
    return main(["benchmark", "make", *map(str, [*words, *sizes])])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("embreex", reason="benchmarks are ray cast with embreex")
    folder = tmp_path_factory.mktemp("models")
    edit = folder / "leaning.json"
    edit.write_text('{"version": 2, "edits": [{"type": "twist", "axis": "z", "angle_deg": 90}]}')
    out = folder / "out"
    assert make(save(figure(), folder), "-o", out, "--edits", edit, *STATE_VIEWS) == 0
    return out


def test_maps_are_those_of_the_skinning(made: Path) -> None:
    record = json.loads((made / "scene.json").read_text())
    center = np.array(record["normalisation"]["centre"])
    scale = record["normalisation"]["scale"]
    place, _, faces = bar()
    with np.load(made / "meshes.npz") as meshes:
        assert set(meshes) == {
            *("canonical", "faces", "sample_face", "sample_barycentric", "sample_visible"),
            *("twist60", "bend60", "stretch", "scale2x", "leaning", "bow"),
        }
        canonical, bow = meshes["canonical"], meshes["bow"]
        assert np.array_equal(meshes["faces"], faces)
    assert np.abs(canonical - (z_up(place) - center) * scale).max() < 1e-6
    assert np.linalg.norm(canonical, axis=1).max() == pytest.approx(1)
    # The file holds single precision; the clip ends where it differs most.
    assert record["states"]["bow"]["time"] == 2.0
    assert np.abs(bow - (z_up(bowed(place, TURN)) - center) * scale).max() < 1e-6


def test_analytic_states_are_their_formulas(made: Path) -> None:
    truth = load_truth(made)
    for name in ("twist60", "bend60", "stretch", "scale2x"):
        formula = truth.analytic(name)
        assert formula is not None
        with np.load(made / "meshes.npz") as meshes:
            before, after = meshes["canonical"], meshes[name]
        assert np.abs(formula(torch.from_numpy(before)).numpy() - after).max() < 1e-9
    assert truth.analytic("bow") is None


def test_states_have_the_training_photos_that_are_asked_for(made: Path) -> None:
    state = load_state(made, "bow")
    assert [len(state.split(name)) for name in ("train", "test")] == [2, VIEWS]
    assert len(pcore.load_scene(made).split("train")) == 4


def test_pictures_show_the_state_that_is_meant(made: Path) -> None:
    """Alpha and depth of every state are those of its mesh by the reader of true meshes."""
    states = open_states(made)
    assert set(states.names) == {"twist60", "bend60", "stretch", "scale2x", "leaning", "bow"}
    for state in states.select(["all"]):
        place = made if state.name == "canonical" else made / state.name
        for number, shot in enumerate(state.shots):
            assert shot.depth is not None
            expected = shot.depth().numpy()
            with np.load(place / "test_geometry" / f"r_{number}.npz") as geometry:
                depth, normal = geometry["depth"], geometry["normal"]
            both = np.isfinite(expected) & np.isfinite(depth)
            assert np.isfinite(expected).sum() == pytest.approx(both.sum(), abs=3)
            assert np.median(np.abs(expected[both] - depth[both])) < 1e-5
            alpha = shot.view.alpha().numpy()
            assert np.abs(alpha - np.isfinite(depth)).mean() < 0.02
            assert np.linalg.norm(normal[both], axis=1) == pytest.approx(1, abs=1e-3)


def test_colours_are_those_of_the_texture(made: Path) -> None:
    pictures = [np.asarray(Image.open(made / "train" / f"r_{k}.png")) for k in range(4)]
    pixels = np.stack(pictures).astype(float)
    solid = pixels[pixels[..., 3] == 255]
    red, blue = solid[:, 0] > 2 * solid[:, 2], solid[:, 2] > 2 * solid[:, 0]
    # The bar is four pixels wide, so that one in four may show the seam.
    assert (red | blue).mean() >= 0.7
    assert min(red.mean(), blue.mean()) > 0.1
    assert solid[:, 1].max() < 40


def test_silhouettes_are_those_of_another_renderer(shared_data: Path) -> None:
    """The knight of the evaluation set, which Blender drew from the same mesh."""
    folder = shared_data / "deformed" / "knight" / "run"
    frames = json.loads((folder / "transforms_test.json").read_text())
    with np.load(folder.parent / "meshes.npz") as meshes:
        vertices, faces = meshes["run"].astype(float), meshes["faces"].astype(np.int64)
    look = Look(materials=(Material(),), material_of_face=np.zeros(len(faces), np.int64))
    shape, pose = Shape.of(vertices, faces, look), frames["frames"][3]["transform_matrix"]
    angle = frames["camera_angle_x"]
    shot = take(shape, look, shape, np.array(pose), angle_x=angle, resolution=200)
    known = np.asarray(Image.open(folder / "test" / "r_3.png"))[..., 3].astype(int)
    off = np.abs(known - shot.rgba[..., 3])
    assert off.mean() < 0.5
    assert off.max() <= 96


def test_clips_and_what_does_not_move(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = save(figure(), tmp_path)
    words = ["--no-analytic", "--light", "baked"]
    assert make(path, "-o", tmp_path / "out", *words, "--canonical", "Bow@1") == 0
    assert "left out: the clip 'Stay' does not move the shape" not in capsys.readouterr().out
    with np.load(tmp_path / "out" / "meshes.npz") as meshes:
        states = {name: meshes[name] for name in meshes if name in ("bow", "stay")}
    assert set(states) == {"bow", "stay"}
    again = [path, "-o", tmp_path / "two", *words]
    assert make(*again, "--clips", "Bow@0.5", "--canonical", "Stay@0") == 0
    record = json.loads((tmp_path / "two" / "scene.json").read_text())
    assert record["states"]["bow"]["time"] == 0.5
    assert record["light"] == "baked"
    assert make(*again[:1], "-o", tmp_path / "three", "--no-analytic") == 0
    assert "left out: the clip 'Stay' does not move" in capsys.readouterr().out


def test_baked_light_moves_along_and_fixed_light_does_not() -> None:
    """A plate that is turned over: its painted brightness stays, or is that of its new side."""
    ray_caster_class()
    plate = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    look = Look(materials=(Material(),), material_of_face=np.zeros(2, np.int64))
    turned = plate * [1, -1, -1]
    flat, over = Shape.of(plate, faces, look), Shape.of(turned, faces, look)
    pose = np.eye(4)
    pose[2, 3] = 4.0
    under = np.diag([1.0, -1, -1, 1])
    under[2, 3] = -4.0
    shots = {"angle_x": 0.7, "resolution": 16}
    bright = take(flat, look, flat, pose, **shots).rgba[8, 8, 0]
    below = take(over, look, over, under, **shots).rgba[8, 8, 0]
    baked = take(over, look, flat, under, **shots).rgba[8, 8, 0]
    assert abs(int(bright) - int(baked)) <= 2
    assert int(below) < int(bright) - 30


def test_what_is_cut_out_lets_rays_pass() -> None:
    ray_caster_class()
    plates = np.array([[-1.0, -1, z] for z in (0.0, -1.0)] * 4).reshape(4, 2, 3).transpose(1, 0, 2)
    plates[:, :, :2] = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    clear = np.zeros((2, 2, 4), np.uint8)
    clear[:, 0] = 255  # Its left half is there.
    look = Look(
        materials=(
            Material(color=(1, 1, 1, 1), texture=Texture(pixels=clear), cutoff=0.5),
            Material(color=(0, 1, 0, 1)),
        ),
        material_of_face=np.array([0, 0, 1, 1]),
        uv=(np.tile([[0.0, 0], [1, 0], [1, 1], [0, 1]], (2, 1)),),
    )
    shape = Shape.of(plates.reshape(-1, 3), faces, look)
    pose = np.eye(4)
    pose[2, 3] = 6.0
    shot = take(shape, look, shape, pose, angle_x=0.5, resolution=16)
    assert shot.depth[8, 4] == pytest.approx(6.0)
    assert shot.depth[8, 11] == pytest.approx(7.0)
    assert shot.rgba[8, 11, 1] > 100
    assert shot.rgba[8, 11, 0] == 0


def test_smooth_patches_share_a_normal_in_every_state() -> None:
    place, _, faces = bar(sides=24)
    patches = smooth_patches(place, None)
    normals = corner_normals(place, faces, patches)
    inner = (place[faces][..., 1] > 0.1) & (place[faces][..., 1] < 1.9)
    out = place[faces] * [1, 0, 1]
    out = out / np.linalg.norm(out, axis=-1, keepdims=True)
    product = np.abs((normals * out).sum(-1))[inner]
    assert product.min() > 0.9999
    assert smooth_patches(place, np.zeros_like(place)).max() == -1


def test_keys_between_keys() -> None:
    """Against the formulas of the standard, written out for one number."""
    times = np.array([1.0, 3.0])
    line = {"node": 0, "path": "translation", "times": times}
    values = np.array([[0.0, 2, 0], [4, 2, 0]])
    assert value_at(Track(**line, values=values, interpolation="LINEAR"), 1.5)[0] == 1.0
    assert value_at(Track(**line, values=values, interpolation="STEP"), 2.9)[0] == 0.0
    assert value_at(Track(**line, values=values, interpolation="STEP"), 3.0)[0] == 4.0
    assert value_at(Track(**line, values=values, interpolation="LINEAR"), 9.0)[0] == 4.0
    spline = np.zeros((2, 3, 3))
    spline[0, 1, 0], spline[0, 2, 0], spline[1, 0, 0], spline[1, 1, 0] = 1.0, 0.5, -0.25, 2.0
    t, length = 0.3, 2.0
    expected = (
        (2 * t**3 - 3 * t**2 + 1) * 1.0
        + length * (t**3 - 2 * t**2 + t) * 0.5
        + (-2 * t**3 + 3 * t**2) * 2.0
        + length * (t**3 - t**2) * -0.25
    )
    track = Track(**line, values=spline, interpolation="CUBICSPLINE")
    assert value_at(track, 1.0 + t * length)[0] == pytest.approx(expected)
    quarter = np.array([[0, 0, 0, 1.0], [0, 0, -np.sin(np.pi / 4), -np.cos(np.pi / 4)]])
    turn = Track(node=0, path="rotation", times=times, values=quarter, interpolation="LINEAR")
    # The short way round, although the second quaternion has the other sign.
    assert np.abs(value_at(turn, 2.0) @ [0, 0, np.sin(np.pi / 8), np.cos(np.pi / 8)]) == (
        pytest.approx(1)
    )


def test_other_files_have_their_paint(tmp_path: Path) -> None:
    Image.fromarray(np.full((2, 2, 3), (0, 200, 0), np.uint8)).save(tmp_path / "green.png")
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd green.png\n")
    (tmp_path / "a.obj").write_text(
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n"
    )
    model = read_model(tmp_path / "a.obj")
    place = np.full((1, 3), 1 / 3)
    rgba = model.look.rgba(model.faces, np.array([0]), place)
    assert rgba[0, 1] > 0.5
    assert rgba[0, 0] < 0.01
    (tmp_path / "b.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0 255 0 0\n1 0 0 255 0 0\n0 1 0 255 0 0\n3 0 1 2\n"
    )
    model = read_model(tmp_path / "b.ply")
    assert model.look.rgba(model.faces, np.array([0]), place)[0, :3] == pytest.approx([1, 0, 0])
    assert model.vertices[2] == pytest.approx([0, 1, 0])
    # A triangle and a square: trimesh gives such files up.
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 5\nproperty float x\n"
    head += "property float y\nproperty float z\nelement face 2\n"
    head += "property list uchar uint vertex_indices\nend_header\n"
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)], "<f4").tobytes()
    square = b"\4" + np.array([0, 1, 2, 3], "<u4").tobytes()
    third = b"\3" + np.array([1, 4, 2], "<u4").tobytes()
    (tmp_path / "c.ply").write_bytes(head.encode() + corners + square + third)
    assert len(read_model(tmp_path / "c.ply").faces) == 3


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ("comment TextureFile skin.png\n", r"painted with a texture \(TextureFile skin.png\)"),
        ("property float red\nproperty float green\nproperty float blue\n", "no known range"),
    ],
)
def test_paint_of_a_ply_that_is_not_read_is_no_grey(tmp_path: Path, head: str, said: str) -> None:
    rows = "".join(
        f"{x} {y} 0{' 1e9 0 0' if 'red' in head else ''}\n" for x, y in ((0, 0), (1, 0), (0, 1))
    )
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        f"property float z\n{head}element face 1\nproperty list uchar int vertex_indices\n"
        f"end_header\n{rows}3 0 1 2\n"
    )
    with pytest.raises(InputError, match=said):
        read_model(tmp_path / "a.ply")


def in_files(made: Builder, folder: Path) -> Path:
    """The model as a .gltf with its numbers and its texture in files beside it."""
    folder.mkdir()
    tree = made.tree
    (folder / "my numbers.bin").write_bytes(made.binary)
    tree["buffers"] = [{"byteLength": len(made.binary), "uri": "my%20numbers.bin"}]
    (folder / "skin.png").write_bytes(picture())
    tree["images"] = [{"uri": "skin.png"}]
    path = folder / "figure.gltf"
    path.write_text(json.dumps(tree))
    return path


@pytest.mark.parametrize("gone", ["a.mtl", "green.png"])
def test_paint_that_is_missing_is_no_grey(tmp_path: Path, gone: str) -> None:
    if gone != "a.mtl":
        (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd green.png\n")
    (tmp_path / "a.obj").write_text(
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n"
    )
    with pytest.raises(InputError, match=rf"files of its paint beside it, missing: {gone}"):
        read_model(tmp_path / "a.obj")


def test_a_model_in_several_files_is_the_same(tmp_path: Path) -> None:
    one = read_model(save(figure(), tmp_path))
    path = in_files(figure(), tmp_path / "parts")
    other = read_model(path)
    assert np.array_equal(one.vertices, other.vertices)
    assert np.array_equal(one.at(one.clips[0], 1.3), other.at(other.clips[0], 1.3))
    face, middle = np.arange(20), np.full((20, 3), 1 / 3)
    assert np.array_equal(
        one.look.rgba(one.faces, face, middle), other.look.rgba(other.faces, face, middle)
    )
    (path.parent / "skin.png").unlink()
    with pytest.raises(InputError, match=r"expected the file 'skin.png' beside it"):
        read_model(path)
    path.write_text(path.read_text().replace("skin.png", "../figure.glb"))
    with pytest.raises(InputError, match="outside its folder"):
        read_model(path)


def test_paint_of_an_older_kind_of_material(tmp_path: Path) -> None:
    made = figure()
    diffuse = {"diffuseFactor": [0.5, 0.25, 1, 1]}
    old = {"KHR_materials_pbrSpecularGlossiness": diffuse}
    made.tree["materials"] = [{"extensions": old}]
    model = read_model(save(made, tmp_path))
    rgba = model.look.rgba(model.faces, np.array([0]), np.full((1, 3), 1 / 3))
    assert rgba[0] == pytest.approx([0.5, 0.25, 1, 1])


@pytest.mark.parametrize(
    ("moved", "message"),
    [
        ([1], "KHR_texture_transform"),
        ({"rotation": "x"}, "KHR_texture_transform.rotation"),
        ({"texCoord": -1}, "KHR_texture_transform.texCoord"),
        ({"offset": [float("nan"), 0]}, "KHR_texture_transform.offset.0"),
        ({"scale": [1]}, "KHR_texture_transform.scale"),
        ({"texCoord": 2}, "TEXCOORD_0 or 1, got TEXCOORD_2"),
    ],
)
def test_a_damaged_texture_transform_is_named(tmp_path: Path, moved: Any, message: str) -> None:
    made = figure()
    info = made.tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    info["extensions"] = {"KHR_texture_transform": moved}
    with pytest.raises(InputError, match=message):
        read_model(save(made, tmp_path))


@pytest.mark.parametrize(
    ("texture", "message"),
    [
        ({"extensions": {"EXT_texture_webp": 3}}, "EXT_texture_webp"),
        ({"extensions": {"KHR_texture_basisu": {"source": 0}}}, "got KHR_texture_basisu"),
    ],
)
def test_a_texture_that_is_not_read_is_named(tmp_path: Path, texture: Any, message: str) -> None:
    made = figure()
    made.tree["textures"] = [texture]
    with pytest.raises(InputError, match=message):
        read_model(save(made, tmp_path))
    made.tree["textures"] = [{"extensions": {"EXT_texture_webp": {"source": 0}}}]
    assert read_model(save(made, tmp_path)).look.materials[0].texture is not None


def test_two_skeletons_move_each_their_own_mesh(tmp_path: Path) -> None:
    """A second figure on bones of its own, moved aside and bent by half of the angle."""
    made = figure()
    tree = made.tree
    aside = np.array([3.0, 0.0, 0.0])
    tree["skins"].append({**tree["skins"][0], "joints": [4, 5]})
    tree["nodes"] += [
        {"mesh": 0, "skin": 1},
        {"children": [5], "translation": aside.tolist()},
        {"translation": [0, 1, 0]},
    ]
    tree["scenes"] = [{"nodes": [0, 1, 3, 4]}]
    half = TURN / 4
    keys = made.array(np.array([[0, 0, 0, 1], [0, 0, np.sin(half), np.cos(half)]]))
    clip = tree["animations"][0]
    clip["samplers"].append({"input": clip["samplers"][0]["input"], "output": keys})
    clip["channels"].append({"sampler": 1, "target": {"node": 5, "path": "rotation"}})
    model = read_model(save(made, tmp_path))
    place, *_ = bar()
    expected = np.concatenate([bowed(place, TURN), bowed(place, TURN / 2) + aside])
    assert np.abs(model.at(model.clips[0], 2.0) - z_up(expected)).max() < 1e-6


def no_keys(made: Builder) -> None:
    made.tree["animations"][0]["samplers"][0]["output"] = made.array(np.zeros((3, 4)))


def falling_times(made: Builder) -> None:
    made.tree["animations"][0]["samplers"][0]["input"] = made.array(np.array([2.0, 1.0]))


def moved_by_pointer(made: Builder) -> None:
    pointer = {"KHR_animation_pointer": {"pointer": "/nodes/2/rotation"}}
    made.tree["animations"][0]["channels"][0]["target"] = {"path": "pointer", "extensions": pointer}


def no_material(made: Builder) -> None:
    made.primitive["material"] = 7


def broken_picture(made: Builder) -> None:
    made.tree["images"][0]["bufferView"] = made.view(np.zeros(16, np.uint8), "u1")


def outside_picture(made: Builder) -> None:
    made.tree["images"] = [{"uri": "skin.png"}]


def no_triangles(made: Builder) -> None:
    made.primitive["mode"] = 0


def not_a_number(made: Builder) -> None:
    place, *_ = bar()
    place[3, 1] = np.nan
    made.primitive["attributes"]["POSITION"] = made.array(place)


def flat_point(made: Builder) -> None:
    place, *_ = bar()
    made.primitive["attributes"]["POSITION"] = made.array(np.zeros_like(place))
    del made.node["skin"]
    del made.tree["skins"]


def thin_line(made: Builder) -> None:
    place, *_ = bar()
    made.primitive["attributes"]["POSITION"] = made.array(place * [0, 1, 0])


def clear_glass(made: Builder) -> None:
    pbr = {"baseColorFactor": [1, 1, 1, 0.1]}
    made.tree["materials"] = [{"pbrMetallicRoughness": pbr, "alphaMode": "BLEND"}]


def short_fan(made: Builder) -> None:
    made.primitive["mode"] = 6
    made.primitive["indices"] = made.array(np.array([0]), "u4")


def joint_before_the_first(made: Builder) -> None:
    count = len(bar()[0])
    made.primitive["attributes"]["JOINTS_0"] = made.array(np.full((count, 4), -1), "i1")


def shrinks_away(made: Builder) -> None:
    """From nothing to nothing, so that no other time can be taken."""
    keys = made.array(np.zeros((2, 3)))
    made.tree["nodes"].append({"children": [0, 1]})
    made.tree["scenes"] = [{"nodes": [3]}]
    clip = made.tree["animations"][0]
    clip["samplers"].append({"input": clip["samplers"][0]["input"], "output": keys})
    clip["channels"].append({"sampler": 1, "target": {"node": 1, "path": "scale"}})


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (thin_line, "expected a surface, got triangles without any area"),
        (clear_glass, "got empty pictures: all of it is cut out by its alpha"),
        (short_fan, "expected a mesh with faces"),
        (joint_before_the_first, "expected joints from 0 to 1, got -1"),
        (shrinks_away, "state 'bow': expected a shape of some extent, got one that has vanished"),
        (no_keys, "expected 8 numbers for the rotation of node 2, got 12"),
        (
            moved_by_pointer,
            "/nodes/2/rotation is moved by KHR_animation_pointer",
        ),
        (falling_times, "finite keys at rising times for the rotation of node 2"),
        (no_material, "one of its 1 materials, got 7"),
        (broken_picture, "expected a texture in PNG, JPEG or WebP, got one that cannot be read"),
        (outside_picture, "expected textures inside the file, got 'skin.png'"),
        (no_triangles, "expected a mesh with faces"),
        (not_a_number, "expected finite coordinates, got NaN"),
        (flat_point, "expected a shape of some extent, got one of radius 0"),
    ],
)
def test_models_that_are_refused(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    harm: Callable[[Builder], None],
    message: str,
) -> None:
    made = figure()
    harm(made)
    assert make(save(made, tmp_path), "-o", tmp_path / "out") == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_options_that_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = save(figure(), tmp_path)
    out = ["-o", tmp_path / "out"]
    for words, message in (
        (["--clips", "Jump"], "expected one of its clips ('Bow', 'Stay'), got 'Jump'"),
        (["--clips", "Bow@soon"], "expected one of its clips ('Bow', 'Stay'), got 'Bow@soon'"),
        (["--clips", "Bow@99"], "expected a time of the clip 'Bow' from 0 to 2 seconds, got 99"),
        (["--clips", "Bow@nan"], "from 0 to 2 seconds, got nan"),
        (["--canonical", "Bow@-1"], "from 0 to 2 seconds, got -1"),
        (["--no-analytic", "--clips", "Stay"], "expected at least one state, got none"),
    ):
        assert make(path, *out, *words) == 2
        assert message in capsys.readouterr().err
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    assert make(path, *out) == 2
    assert "expected a new or empty folder, got one with files" in capsys.readouterr().err
    with pytest.raises(InputError, match="no such file"):
        read_model(tmp_path / "none.glb")


def test_a_clip_with_an_at_in_its_name(tmp_path: Path) -> None:
    made = figure()
    made.tree["animations"][0]["name"] = "Rig@Bow"
    words = ["--no-analytic", "--clips", "Rig@Bow", "Rig@Bow@1"]
    assert make(save(made, tmp_path), "-o", tmp_path / "out", *words) == 0
    states = json.loads((tmp_path / "out" / "scene.json").read_text())["states"]
    assert [one["time"] for one in states.values()] == [2.0, 1.0]


def test_what_is_not_visible_is_not_shown(tmp_path: Path) -> None:
    made = figure()
    whole = len(read_model(save(made, tmp_path)).faces)
    hidden = {"KHR_node_visibility": {"visible": False}}
    made.tree["nodes"] += [{"children": [4], "extensions": hidden}, {"mesh": 0, "skin": 0}]
    made.tree["scenes"] = [{"nodes": [0, 1, 3]}]
    assert len(read_model(save(made, tmp_path)).faces) == whole


def test_a_time_is_taken_at_which_the_shape_is_there(tmp_path: Path) -> None:
    """A clip at whose end the figure shrinks to nothing."""
    made = figure()
    shrinks_away(made)
    keys = made.array(np.array([[1.0, 1, 1], [0, 0, 0]]))
    made.tree["animations"][0]["samplers"][1]["output"] = keys
    made.tree["nodes"][0].pop("skin")
    made.tree["animations"][0]["channels"][1]["target"]["node"] = 3
    assert make(save(made, tmp_path), "-o", tmp_path / "out", "--no-analytic") == 0
    states = json.loads((tmp_path / "out" / "scene.json").read_text())["states"]
    assert 1.5 < states["bow"]["time"] < 2.0


def test_a_scaled_model_makes_the_same_benchmark(tmp_path: Path, made: Path) -> None:
    large = figure()
    large.tree["nodes"].append({"children": [0, 1], "scale": [1000, 1000, 1000]})
    large.tree["scenes"] = [{"nodes": [3]}]
    assert make(save(large, tmp_path), "-o", tmp_path / "out", "--no-analytic") == 0
    with np.load(tmp_path / "out" / "meshes.npz") as ours, np.load(made / "meshes.npz") as known:
        assert np.abs(ours["bow"] - known["bow"]).max() < 1e-5


def test_it_is_a_scene(made: Path) -> None:
    scene = pcore.load_scene(made)
    assert [len(scene.split(name)) for name in ("train", "test")] == [4, VIEWS]
    assert scene.split("train")[0].has_alpha
    assert len(camera_poses(3, radius=1, highest=0.9, phase=0)) == 3


RECIPE = """
version: 1
options: {size: 24, train_views: 3, test_views: 1, no_analytic: true}
models:
  one: {file: figure.glb}
  two: {file: figure.glb, options: {size: 16, clips: [Bow@0.5]}}
"""


def test_a_recipe_makes_all_its_models(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("embreex", reason="benchmarks are ray cast with embreex")
    save(figure(), tmp_path)
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(RECIPE)
    words = ["benchmark", "make", "--recipe", str(recipe), "-o", str(tmp_path / "out")]
    assert main(words) == 0
    records = [
        json.loads((tmp_path / "out" / n / "scene.json").read_text()) for n in ("one", "two")
    ]
    assert [one["resolution"] for one in records] == [24, 16]
    assert [one["states"]["bow"]["time"] for one in records] == [2.0, 0.5]
    capsys.readouterr()
    for text, message in (
        (RECIPE.replace("size: 24", "size: 25"), "expected a new or empty folder"),
        (RECIPE.replace("size: 16", "edits: [none.json]"), "none.json"),
        (RECIPE.replace("one: {file: figure.glb}", "one: {file: a.glb, source: b}"), "a.glb (b)"),
        (RECIPE.replace("size: 16", "sise: 16"), "recipe.yaml: two: "),
        (RECIPE.replace("size: 16", "output: x"), "got one that the recipe gives to each"),
        (RECIPE.replace("version", "versions"), "'version' is missing"),
        (RECIPE.replace("  two:", "  ../two:"), "can be folders, of letters, digits"),
        ("[", "expected YAML"),
    ):
        recipe.write_text(text)
        assert main(words) == 2
        assert message in capsys.readouterr().err
    assert main([*words, "--size", "9"]) == 2
    assert "expected no models or options besides -o, got size" in capsys.readouterr().err


def test_a_recipe_goes_on_where_it_stopped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing is made before all can be, and nothing is made twice."""
    pytest.importorskip("embreex", reason="benchmarks are ray cast with embreex")
    save(figure(), tmp_path)
    out, recipe, damaged = tmp_path / "out", tmp_path / "recipe.yaml", tmp_path / "three.glb"
    recipe.write_text(RECIPE + "  three: {file: three.glb, options: {edits: lean.json}}\n")
    (tmp_path / "lean.json").write_text(
        '{"version": 2, "edits": [{"type": "twist", "axis": "z", "angle_deg": 90}]}'
    )
    words = ["benchmark", "make", "--recipe", str(recipe), "-o", str(out)]
    damaged.write_bytes(figure().content())
    right = recipe.read_text()
    recipe.write_text(right.replace("Bow@0.5", "Bow@9"))
    assert main(words) == 2
    assert "expected a time of the clip 'Bow' from 0 to 2" in capsys.readouterr().err
    recipe.write_text(right)
    damaged.write_bytes(figure().content()[:-99])
    assert main(words) == 2
    assert "three.glb: expected a mesh in binary glTF, got a file that is damaged" in (
        capsys.readouterr().err
    )
    assert not out.exists()
    damaged.write_bytes(figure().content())
    assert main(words) == 0
    assert "lean" in json.loads((out / "three" / "scene.json").read_text())["states"]
    shutil.rmtree(out / "two")
    before = (out / "one" / "meshes.npz").stat().st_mtime_ns
    capsys.readouterr()
    assert main(words) == 0
    told = capsys.readouterr().out
    assert told.count("made already") == 2
    assert "two: " in told
    assert (out / "two" / "meshes.npz").is_file()
    assert (out / "one" / "meshes.npz").stat().st_mtime_ns == before


def test_a_recipe_of_one_model_goes_on_unless_its_rig_is_another(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("embreex", reason="benchmarks are ray cast with embreex")
    save(figure(), tmp_path)
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(RECIPE.partition("  two:")[0])
    words = ["benchmark", "make", "--recipe", str(recipe), "-o", str(tmp_path / "out")]
    assert main(words) == 0
    assert "made already" not in capsys.readouterr().out
    assert main(words) == 0
    assert "made already" in capsys.readouterr().out
    assert make(tmp_path / "figure.glb", "-o", tmp_path / "out" / "one") == 2
    assert "expected a new or empty folder" in capsys.readouterr().err
    # Another share of the bones: at rest nothing is seen of it.
    rig, place = figure(), bar()[0]
    before = read_model(tmp_path / "figure.glb").vertices
    shares = np.tile([0.5, 0.5, 0, 0], (len(place), 1))
    rig.primitive["attributes"]["WEIGHTS_0"] = rig.array(shares)
    assert np.array_equal(read_model(save(rig, tmp_path)).vertices, before)
    assert main(words) == 2
    assert "expected a new or empty folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "size: 16",
            "edits: null",
            "two: 'edits': expected an edit file or a list of them, got No",
        ),
        ("size: 16", "edits: true", "'edits': expected an edit file or a list of them, got True"),
        ("size: 16", "edits: {a: 1}", "expected an edit file or a list of them, got {'a': 1}"),
        ("size: 16", "edits: [1]", "expected an edit file or a list of them, got [1]"),
        ("size: 16", "--edits: none.json", "{beside}/none.json"),
        (
            "  two:",
            "  One:",
            "'models': expected names that differ by more than case, got one, One",
        ),
    ],
)
def test_recipes_that_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, said: str
) -> None:
    save(figure(), tmp_path)
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(RECIPE.replace(old, new))
    assert main(["benchmark", "make", "--recipe", str(recipe), "-o", str(tmp_path / "out")]) == 2
    assert said.replace("{beside}", str(tmp_path)) in capsys.readouterr().err


def test_a_vertex_of_no_triangle_widens_nothing(tmp_path: Path) -> None:
    place, _, faces = bar()
    found = []
    for name, places in (("clean", place), ("stray", np.vstack([place, [[50.0, 0.0, 0.0]]]))):
        path = tmp_path / f"{name}.ply"
        names = "".join(f"property float {axis}\n" for axis in "xyz")
        path.write_text(
            f"ply\nformat ascii 1.0\nelement vertex {len(places)}\n{names}element face "
            f"{len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
            + "".join("{:g} {:g} {:g}\n".format(*p) for p in places)
            + "".join("3 {} {} {}\n".format(*f) for f in faces)
        )
        found.append(read_model(path).vertices)
    clean, stray = found
    assert np.abs(stray[: len(clean)] - clean).max() == 0
    assert np.ptp(stray, axis=0).tolist() == np.ptp(clean, axis=0).tolist()


def test_a_picture_in_bands_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("embreex", reason="pictures are ray cast with embreex")
    place, _, faces = bar()
    look = Look(materials=(Material(),), material_of_face=np.zeros(len(faces), dtype=np.int64))
    shape = Shape.of(z_up(place), faces, look)
    pose = camera_poses(1, radius=4, highest=0.9, phase=0)[0]

    def taken() -> Any:
        return take(shape, look, shape, pose, angle_x=0.9, resolution=24)

    whole = taken()
    monkeypatch.setattr("pcore.benchmark.true_picture._MOST_RAYS", 100)
    bands = taken()
    assert whole.rgba[..., 3].max() == 255
    assert (bands.rgba[..., 3] == whole.rgba[..., 3]).all()
    assert (bands.depth == whole.depth).all()
    assert (bands.normal == whole.normal).all()
    # The lamps' places are drawn for every band anew.
    assert np.abs(bands.rgba.astype(float) - whole.rgba).max() < 40


def test_a_quaternion_of_zeros_is_named(tmp_path: Path) -> None:
    made = figure()
    zero = made.array(np.zeros((2, 4)))
    made.tree["animations"][0]["samplers"][0]["output"] = zero
    with pytest.raises(InputError, match="got a quaternion of zeros"):
        read_model(save(made, tmp_path))
