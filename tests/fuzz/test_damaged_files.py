"""Files that went wrong in 500 ways each: a result or a PcoreError, soon, and nothing left behind.

Every way is drawn from a seed, so that a failure names the file that shows it again.
"""

from __future__ import annotations

import io
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from gltf_files import cube
from mutations import bytes_mutated, json_mutated, text_mutated, tree_mutated
from PIL import Image
from ply_files import FACE, box, ply
from tests.data.splat_files import columns_of, ply_bytes, splat_bytes
from tests.gaussians.some import some_gaussians
from toys import CONFIG, toy_cameras, toy_cloud, write_cameras, write_run, write_scene

from pcore.asset.saving import load
from pcore.asset.training import finetune_settings
from pcore.capture.load import load_cameras, load_scene
from pcore.cli.info_rows import describe
from pcore.cli.main import main
from pcore.data.images import read_rgba
from pcore.data.meshes import read_mesh
from pcore.data.points import load_points, read_point_file, save_moved
from pcore.data.splat_formats import read_splats
from pcore.editing.animation import load_animation
from pcore.errors import PcoreError
from pcore.files.model_file import load_model
from pcore.files.official import load_official, to_official_state
from pcore.files.official_config import read_settings
from pcore.model.papr import Papr

Mutate = Callable[[bytes, Random], bytes]
TIMES = int(os.environ.get("PCORE_FUZZ_TIMES", "500"))
SECONDS = 20.0
"""Processor time of one file after which it counts as one that hangs."""
COMMANDS = 60
"""Every so many files are also given to the command line."""


@dataclass(frozen=True, kw_only=True)
class Format:
    """A kind of files.

    Attributes:
        file: where the harmed file lies in the world.
        make: puts a whole one there, with what it needs.
        mutate: harms it.
        read: uses it as the package does; gets the world.
        command: what a user would call.
    """

    file: str
    make: Callable[[Path], None]
    mutate: Mutate
    read: Callable[[Path], object]
    command: str


POINTS = torch.rand(60, 3, generator=torch.Generator().manual_seed(1)) * 2 - 1
TWIST = {"version": 2, "edits": [{"type": "twist", "axis": "z", "angle_deg": 30}]}
EDIT = {
    "version": 2,
    "freeze": [{"shape": "half_space", "normal": "z", "origin": [0, 0, -0.8], "falloff": 0.2}],
    "edits": [
        {"type": "bend", "axis": "z", "angle_deg": 20, "limits": [0.1, 0.9]},
        {
            "type": "part",
            "axis": "z",
            "angle_deg": 40,
            "region": {"shape": "sphere", "center": [0.2, 0, 0], "radius": 0.6, "falloff": 0.2},
        },
        {"type": "stretch", "axis": [0, 1, 0], "factor": {"keyframes": [[0, 1.0], [1, 1.5]]}},
        {"type": "cage", "before": "box.ply", "after": "box.ply", "amount": 0.5},
    ],
}


def put(world: Path, name: str, content: bytes | str) -> None:
    (world / name).parent.mkdir(parents=True, exist_ok=True)
    (world / name).write_bytes(content.encode() if isinstance(content, str) else content)


def scene(world: Path) -> None:
    write_scene(world / "ball", train=3, test=1)


def cameras(world: Path) -> None:
    write_cameras(world / "cameras.json", toy_cameras(3), w=16, h=16, fl_x=21.9)
    write_run(world / "run", points=20)


def edit(world: Path) -> None:
    put(world, "edit.json", json.dumps(EDIT))
    put(world, "box.ply", ply(box(), FACE))
    np.save(world / "points.npy", POINTS.numpy())


def points_of(content: Callable[[], bytes]) -> Callable[[Path], None]:
    def make(world: Path) -> None:
        put(world, "in.ply", content())
        put(world, "twist.json", json.dumps(TWIST))

    return make


def splat(world: Path) -> None:
    put(world, "in.splat", splat_bytes(6))
    put(world, "twist.json", json.dumps(TWIST))


def colored(encoding: str) -> bytes:
    parts = ("uchar red", "float nx", "float ny", "float nz", "list uchar short ids")
    values = [[7 * k for k in range(8)], *[[0.5] * 8] * 3, [[k] * (k % 3) for k in range(8)]]
    return ply(box(*parts, values=values), FACE, encoding=encoding)


def array(world: Path) -> None:
    np.save(world / "in.npy", POINTS.numpy())
    put(world, "twist.json", json.dumps(TWIST))


def mesh(name: str, content: Callable[[], bytes]) -> Callable[[Path], None]:
    def make(world: Path) -> None:
        put(world, name, content())
        np.save(world / "points.npy", POINTS.numpy() * 0.2 + 0.5)
        cage = {"type": "cage", "before": name, "after": name}
        put(world, "edit.json", json.dumps({"version": 2, "edits": [cage]}))

    return make


def shaped() -> bytes:
    """A glTF file with everything that is read: nodes, a skin, morph targets, a sparse array."""
    made = cube()
    made.primitive["targets"] = [{"POSITION": made.array(np.ones((8, 3)))}]
    made.tree["meshes"][0]["weights"] = [0.5]
    made.primitive["attributes"] |= {
        "JOINTS_0": made.array(np.tile([0, 1, 0, 0], (8, 1)), "u1"),
        "WEIGHTS_0": made.array(np.tile([0.5, 0.5, 0, 0], (8, 1))),
    }
    binds = made.array(np.tile(np.eye(4).reshape(1, 16), (2, 1)))
    made.tree["skins"] = [{"joints": [1, 2], "inverseBindMatrices": binds}]
    made.tree["nodes"] = [
        {"mesh": 0, "skin": 0},
        {"children": [2], "rotation": [0, 0, 0, 1]},
        {"translation": [0, 0, 0.1]},
    ]
    made.tree["scenes"] = [{"nodes": [0, 1]}]
    return made.content()


def glb_mutated(content: bytes, random: Random) -> bytes:
    """Harm the bytes of a .glb, or the tree within."""
    if random.random() < 0.4:
        return bytes_mutated(content, random)
    size = int.from_bytes(content[12:16], "little")
    tree = tree_mutated(json.loads(content[20 : 20 + size]), random)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + size :]
    head = b"glTF" + (2).to_bytes(4, "little") + (20 + len(text) + len(rest)).to_bytes(4, "little")
    return head + len(text).to_bytes(4, "little") + content[16:20] + text + rest


OBJ = b"# cube\no a\n" + b"".join(
    [f"v {x} {y} {z} 0.5 0.5 0.5\n".encode() for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    + [b"vt 0 0\nvn 0 0 1\nf 1/1/1 2/1 4//1 3\nf 5 7 8 6\nf -8 5 6 2\nf 3 4 8 7\n"]
    + [b"f 1 3 7 5\nf 2 6 8 \\\n4\n"]
)


def image(world: Path) -> None:
    scene(world)
    noise = np.random.default_rng(0).integers(0, 255, (16, 16, 4), dtype=np.uint8)
    Image.fromarray(noise, "RGBA").save(world / "ball" / "train" / "r_0.png")


def run(world: Path) -> None:
    write_run(world / "run", points=20, factor=2, preset="tiny", base="../base")


def safetensors_mutated(content: bytes, random: Random) -> bytes:
    """Harm the bytes of a model, its table of tensors or its own header."""
    if random.random() < 0.4:
        return bytes_mutated(content, random)
    size = int.from_bytes(content[:8], "little")
    tree: dict[str, Any] = json.loads(content[8 : 8 + size])
    own = tree["__metadata__"]
    key = random.choice([name for name in own if own[name].startswith("{")])
    if random.random() < 0.7:
        own[key] = json.dumps(tree_mutated(json.loads(own[key]), random))
    else:
        tree = tree_mutated(tree, random)
    text = json.dumps(tree).encode()
    return len(text).to_bytes(8, "little") + text + content[8 + size :]


def official(world: Path) -> None:
    state = to_official_state(Papr(CONFIG), toy_cloud(20))
    torch.save({"250000": state}, world / "model.pth")
    put(world, "toy.yml", yaml.safe_dump(SETTINGS))


SETTINGS = {
    "index": "toy",
    "dataset": {"coord_scale": 10.0},
    "geoms": {"background": {"constant": 5.0}, "points": {"select_k_type": "d2r"}},
    "models": {"transformer": {"embed": {"value": {"ff_act": "relu", "skip_layers": []}}}},
}


def checkpoint_mutated(content: bytes, random: Random) -> bytes:
    """Harm the bytes of a checkpoint, or what it holds."""
    if random.random() < 0.5:
        return bytes_mutated(content, random)
    whole = torch.load(io.BytesIO(content), weights_only=True)
    state = whole["250000"]
    names = sorted(state)
    name, other = random.choice(names), random.choice(names)
    kind = random.randrange(7)
    if kind == 0:
        del state[name]
    elif kind == 1:
        state[name], state[other] = state[other], state[name]
    elif kind == 2:
        state[name] = state[name].reshape(-1)[: random.randrange(5)]
    elif kind == 3:
        state[name] = random.choice([None, 1, "x", [], torch.tensor(1 + 2j), torch.zeros(0)])
    elif kind == 4:
        fill = random.choice([float("nan"), float("inf"), 1e38, 0.0, -1.0, 1e9])
        state[name] = torch.full_like(state[name].float(), fill)
    elif kind == 5:
        state[name.replace("proximity_attn.", "transformer.")] = state.pop(name)
    else:
        whole = random.choice([state, {"x": state}, {"1": state, "2": state}, [state], {}])
    out = io.BytesIO()
    torch.save(whole, out)
    return out.getvalue()


def read_scene(world: Path) -> None:
    found = load_scene(world / "ball")
    for view in found.split("train"):
        view.camera.rays()


def read_edit(world: Path) -> None:
    animation = load_animation(world / "edit.json")
    for time in (animation.start, animation.end):
        bound = animation.at(time).bound(POINTS.double(), allow_folds=True)
        assert bool(torch.isfinite(bound.setting.points).all())


def read_points(name: str) -> Callable[[Path], None]:
    def read(world: Path) -> None:
        found = read_point_file(world / name)
        assert bool(torch.isfinite(found.positions).all())
        maps = torch.eye(3).expand(len(found.positions), 3, 3)
        save_moved(world / "out.ply", found, found.positions + 1, maps)
        load_points(world / "out.ply")
        (world / "out.ply").unlink()

    return read


def read_shape(name: str) -> Callable[[Path], None]:
    def read(world: Path) -> None:
        found = read_mesh(world / name)
        assert bool(torch.isfinite(found.vertices).all())
        assert 0 <= int(found.faces.min()) <= int(found.faces.max()) < len(found.vertices)

    return read


def read_run(world: Path) -> None:
    found = load(world / "run")
    describe(world / "run")
    assert found.record.factor >= 1
    assert finetune_settings(found)[0]
    assert found.record.base is None or isinstance(found.record.base, Path)
    assert found.record.scene_folder is None or found.record.scene_folder.is_dir()


def bytes_or_text_mutated(content: bytes, random: Random) -> bytes:
    """For files with a header in text before bytes."""
    return random.choice((bytes_mutated, text_mutated))(content, random)


DEFORM = "deform in.ply --edit twist.json -o new.ply"
APPLY = "edit apply points.npy --edit edit.json -o new.npy"
RENDER = "render run -o new --device cpu"
FORMATS = {
    "transforms.json": Format(
        file="ball/transforms_train.json",
        make=scene,
        mutate=json_mutated,
        read=read_scene,
        command="train ball -o new --device cpu --steps 1 --points 9 --no-tensorboard",
    ),
    "camera file": Format(
        file="cameras.json",
        make=cameras,
        mutate=json_mutated,
        read=lambda world: load_cameras(world / "cameras.json"),
        command=f"{RENDER} --cameras cameras.json --size 4 4",
    ),
    "edit file": Format(
        file="edit.json", make=edit, mutate=json_mutated, read=read_edit, command=APPLY
    ),
    "PLY in text": Format(
        file="in.ply",
        make=points_of(lambda: colored("ascii")),
        mutate=text_mutated,
        read=read_points("in.ply"),
        command=DEFORM,
    ),
    "PLY in bytes": Format(
        file="in.ply",
        make=points_of(lambda: colored("binary_big_endian")),
        mutate=bytes_or_text_mutated,
        read=read_points("in.ply"),
        command=DEFORM,
    ),
    "PLY of Gaussians": Format(
        file="in.ply",
        make=points_of(lambda: ply_bytes(columns_of(some_gaussians(6)))),
        mutate=bytes_or_text_mutated,
        read=lambda world: read_splats(world / "in.ply"),
        command=DEFORM,
    ),
    "splat": Format(
        file="in.splat",
        make=splat,
        mutate=bytes_mutated,
        read=lambda world: read_splats(world / "in.splat"),
        command="deform in.splat --edit twist.json -o new.splat",
    ),
    "NPY": Format(
        file="in.npy",
        make=array,
        mutate=bytes_mutated,
        read=read_points("in.npy"),
        command="deform in.npy --edit twist.json -o new.npy",
    ),
    "GLB": Format(
        file="in.glb",
        make=mesh("in.glb", shaped),
        mutate=glb_mutated,
        read=read_shape("in.glb"),
        command=APPLY,
    ),
    "OBJ": Format(
        file="in.obj",
        make=mesh("in.obj", lambda: OBJ),
        mutate=text_mutated,
        read=read_shape("in.obj"),
        command=APPLY,
    ),
    "PNG": Format(
        file="ball/train/r_0.png",
        make=image,
        mutate=bytes_mutated,
        read=lambda world: read_rgba(world / "ball" / "train" / "r_0.png", size=(16, 16)),
        command="train ball -o new --device cpu --steps 1 --points 9 --no-tensorboard",
    ),
    "model": Format(
        file="run/model.safetensors",
        make=run,
        mutate=safetensors_mutated,
        read=lambda world: load_model(world / "run").papr(),
        command=f"{RENDER} --orbit 1 --size 4 4",
    ),
    "run.json": Format(
        file="run/run.json", make=run, mutate=json_mutated, read=read_run, command="info run"
    ),
    "PAPR checkpoint": Format(
        file="model.pth",
        make=official,
        mutate=checkpoint_mutated,
        read=lambda world: load_official(world / "model.pth", [world / "toy.yml"]),
        command="import papr model.pth --config toy.yml -o new",
    ),
    "PAPR configuration": Format(
        file="toy.yml",
        make=official,
        mutate=lambda content, random: (
            text_mutated(content, random)
            if random.random() < 0.5
            else yaml.safe_dump(tree_mutated(yaml.safe_load(content), random)).encode()
        ),
        read=lambda world: read_settings([world / "toy.yml"]),
        command="import papr model.pth --config toy.yml -o new",
    ),
}


@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    kind = FORMATS[name]
    monkeypatch.chdir(tmp_path)
    kind.make(tmp_path)
    whole = (tmp_path / kind.file).read_bytes()
    kind.read(tmp_path)
    there = files(tmp_path)
    refused = 0
    for number in range(TIMES):
        content = kind.mutate(whole, Random(f"{name} {number}"))
        (tmp_path / kind.file).write_bytes(content)
        with limited(f"{name} {number}"):
            try:
                kind.read(tmp_path)
            except PcoreError as error:
                refused += 1
                check_words(str(error), f"{name} {number}")
            except Exception:
                pytest.fail(f"{name} {number}: {traceback.format_exc(limit=-4)}")
        assert files(tmp_path) == there, f"{name} {number}: left something behind"
    # Harm that is never noticed would test nothing; harm that is always noticed next to nothing.
    assert 0.2 * TIMES < refused <= TIMES
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files_at_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    kind = FORMATS[name]
    monkeypatch.chdir(tmp_path)
    kind.make(tmp_path)
    whole = (tmp_path / kind.file).read_bytes()
    there = files(tmp_path)
    tried = 0
    for number in range(0, TIMES, COMMANDS):
        (tmp_path / kind.file).write_bytes(kind.mutate(whole, Random(f"{name} {number}")))
        try:
            kind.read(tmp_path)
            continue  # What can be read may well be trained on; that is another test's.
        except PcoreError:
            tried += 1
        assert main(kind.command.split()) == 2
        said = capsys.readouterr().err
        assert said.startswith("Error: ")
        assert "Traceback" not in said
        assert files(tmp_path) == there, f"{name} {number}: left something behind"
    assert tried


def check_words(text: str, what: str) -> None:
    """No words of Python's or of a library's, which say nothing to the user."""
    for word in ("Traceback", "NoneType", "object at 0x", "list index", "KeyError", "ValueError"):
        assert word not in text, f"{what}: {text}"
    assert len(text) < 3000, f"{what}: {text[:300]}"


def files(world: Path) -> set[str]:
    return {str(path.relative_to(world)) for path in world.rglob("*")}


@contextmanager
def limited(what: str) -> Iterator[None]:
    """Fail what takes too much processor time, on systems that can tell."""
    if sys.platform == "win32":
        yield
        return

    def stop(*_: object) -> None:
        raise TimeoutError(f"{what}: more than {SECONDS:g} s")

    before = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)
