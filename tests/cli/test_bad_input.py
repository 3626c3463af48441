"""Everything that people hand over by mistake: a clear error, no traceback, nothing lost or left.

Each case harms a copy of a small world, calls a verb in it as a user would, and compares the files
before and after.
"""

from __future__ import annotations

import json
import pickle
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from harms import (
    EDIT,
    Harm,
    Trap,
    array,
    cut,
    edit,
    folder,
    frame,
    frames,
    gone,
    image,
    keys,
    strange_demo,
    text,
    transparent,
)
from toys import CONFIG, write_run, write_scene

from pcore.cli.main import main
from pcore.data.points import save_points
from pcore.files.official import to_official_state

OFFICIAL = {"dataset": {"coord_scale": 10.0}}
EMPTY_PLY = b"""ply
format ascii 1.0
element vertex 0
property float x
property float y
property float z
end_header
"""


@dataclass(frozen=True)
class Case:
    """A command in a harmed world, and what the message must say, in parts between "|"."""

    command: str
    said: str
    harm: Harm = lambda world: None

    @property
    def name(self) -> str:
        return f"{self.command} > {self.said}"[:90]


TRAP = pickle.dumps(Trap())
SKEWED = [[1.5, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
NO_NUMBER = [[float("nan"), 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
TRAIN = "train ball -o new --device cpu --steps 2 --points 20 --no-tensorboard"
PAPR = f"{TRAIN} --model papr"
FROM_FILE = TRAIN.replace("--points 20 ", "") + " --init"
TUNE = "finetune run -o new --device cpu --steps 2 --no-tensorboard"
RENDER = "render run -o new --device cpu"
EVAL = "eval run --device cpu"
ABLATE = "ablate run --device cpu --steps 1"
DEFORM = "deform points.npy --edit edit.json -o new.npy"
IMPORT = "import papr model.pth --config lego.yml -o new"
JSON = "ball/transforms_train.json"
CASES = [
    # --- train: its scene, its options, its folder
    Case("train nowhere -o new", "scene nowhere: no such folder; check the path"),
    Case("train edit.json -o new", "expected a folder, got a file; give the folder it lies in"),
    Case(
        "train empty -o new",
        "unknown format. Looked for: NeRF-Synthetic (transforms_train.json)",
        lambda world: (world / "empty").mkdir(),
    ),
    Case(TRAIN, "transforms_train.json: expected JSON, got text that does not parse", cut(JSON)),
    Case(TRAIN, "'top level': expected keys with values { ... }, got []", text(JSON, "[]")),
    Case(
        TRAIN,
        "expected text in UTF-8, got bytes that are not UTF-16|save it as",
        text(JSON, b"\xff\xfe\x00"),
    ),
    Case(TRAIN, "'frames': expected a list of at least 1", keys(JSON, frames=[])),
    Case(TRAIN, "expected a horizontal field of view between 0", keys(JSON, camera_angle_x=4.0)),
    Case(TRAIN, "expected images of a pinhole camera, got k1 = 0.1; undistort", keys(JSON, k1=0.1)),
    Case(TRAIN, "images of 16 x 16 pixels expect 'fl_x' 21.9|got 900;", keys(JSON, fl_x=900.0)),
    Case(TRAIN, "frame 1 (./train/r_1): 'transform_matrix':", frame(transform_matrix=None)),
    Case(TRAIN, "expected finite numbers in", frame(transform_matrix=NO_NUMBER)),
    Case(TRAIN, "expected a rigid world_from_camera|remove scale", frame(transform_matrix=SKEWED)),
    Case(TRAIN, "'file_path' leaves the scene's folder", frame(file_path="../edit.json")),
    Case(TRAIN, "parallel|give views from at least two directions", frames(1)),
    Case(TRAIN, "no image at|put it there or remove the frame", gone("ball/train/r_1.png")),
    Case(TRAIN, "r_1.png: expected an image such as PNG,", text("ball/train/r_1.png", "no image")),
    Case(TRAIN, "r_1.png: expected 16 x 16 pixels, got a", cut("ball/train/r_1.png", 0.7)),
    Case(TRAIN, "expected an image of 16 x 16 pixels like the", image("ball/train/r_1.png", 12)),
    Case(TRAIN, "12 images that are transparent all over|are the masks black", transparent),
    Case(PAPR, "12 images that are transparent all over|are the masks black", transparent),
    Case(f"{TRAIN} --factor 3", "16 x 16 images cannot be divided by 3; use one of 1, 2, 4, 8, 16"),
    Case(f"{TRAIN} --factor 0", "down-scaling factor: expected a whole number of at least 1, got"),
    Case(f"{TRAIN} --factor two", "--factor|two"),
    Case(f"{TRAIN} --steps -5", "expected steps >= 1, got -5"),
    Case(f"{TRAIN} --points 0", "expected points >= 1, got 0"),
    Case(f"{TRAIN} --threads 0", "--threads: expected a whole number of at least 1, got 0"),
    Case(f"{TRAIN} --seed 99999999999999999999999", "expected a seed from 0 to 2**63 - 2, got"),
    Case(f"{TRAIN} --preset tyni", "--preset|tyni"),
    Case(f"{PAPR} --front-weight -1", "expected front_weight to be a finite number of 0 or more,"),
    Case(f"{PAPR} --lpips-weight 0.1", "weights are missing. Needed: trunk: vgg16|Looked in"),
    Case(f"{FROM_FILE} absent.ply", "absent.ply: no such file; expected a .npy or .ply of"),
    Case(
        f"{FROM_FILE} points.obj",
        "expected a file of points that ends in .npy or .ply, got '.obj'",
        text("points.obj", "v 0 0 0"),
    ),
    Case(
        f"{FROM_FILE} start.ply",
        "start.ply: expected at least one point, got none",
        text("start.ply", EMPTY_PLY),
    ),
    Case(
        f"{FROM_FILE} start.npy",
        "expected finite coordinates, got NaN or infinity in 9 of 9 points; remove them first",
        array("start.npy", np.full((9, 3), np.nan)),
    ),
    Case(
        f"{FROM_FILE} start.ply",
        "start.ply: cannot read a .npy or .ply",
        folder("start.ply"),
    ),
    Case(
        f"{FROM_FILE} start.npy --points 300",
        "--points 300: expected no number where the points come from a file",
        array("start.npy", np.zeros((9, 3))),
    ),
    Case("train ball", "-o|required"),
    Case("train ball -o run", "run holds a run already, which is not overwritten: continue it"),
    Case("train ball -o ball", "ball holds other files (test, train, transforms_test.json, ...):"),
    Case("train ball -o edit.json", "edit.json is a file: expected a folder for the run; use"),
    Case("train ball -o edit.json/run", "cannot write into edit.json/run|choose another one with"),
    Case(f"{TRAIN} --resume", "nothing to resume at new: expected the folder of an interrupted"),
    Case("train ball -o run --resume --device cpu", "cannot resume run with other settings"),
    Case(
        "train ball -o run --resume",
        "run/run.json: expected JSON, got something else|take it from a copy",
        text("run/run.json", "{"),
    ),
    # --- finetune
    Case("finetune nowhere", "no run at nowhere: expected a folder with a run.json|check the path"),
    Case("finetune ball", "no run at ball"),
    Case(TUNE, "no model at run/model.safetensors: expected", gone("run/model.safetensors")),
    Case(TUNE, "model.safetensors is truncated, damaged or not a", cut("run/model.safetensors")),
    Case(TUNE, "is a pickle file of PyTorch, not a model of", text("run/model.safetensors", TRAP)),
    Case(TUNE, "run.json has version 9 of the run format: this", keys("run/run.json", version=9)),
    Case(TUNE, "the scene it was trained on (../ball) is not a folder here; give", gone("ball")),
    Case(f"{TUNE} --steps 0", "expected steps >= 1, got 0"),
    Case(f"{TUNE} --factor 0", "down-scaling factor: expected a whole number of at least 1, got 0"),
    Case(f"{TUNE} --lpips-weight nan", "expected lpips_weight to be a finite number of 0 or more,"),
    Case(f"{TUNE} --lpips-trunk vgg", "--lpips-trunk vgg: expected an LPIPS loss, got the weight"),
    Case(f"{TUNE} --seed 99999999999999999999999", "expected a seed from 0 to 2**63 - 2, got"),
    Case("finetune run -o run", "run: expected a folder other than that of the run it starts from"),
    Case("finetune run -o mine", "mine holds other files (mine.txt): expected a", folder("mine")),
    # --- render: edits, cameras, options
    Case(f"{RENDER} --edit absent.json", "absent.json: edit file not found; expected a JSON file"),
    Case(f"{RENDER} --edit ball", "ball: cannot be read (Is a directory)"),
    Case(f"{RENDER} --edit edit.json", "edit.json: expected JSON", cut("edit.json")),
    Case(
        f"{RENDER} --edit edit.json",
        'expected "version": 2, got 7',
        edit({"version": 7, "edits": []}),
    ),
    Case(
        f"{RENDER} --edit edit.json",
        'edit 1: key "type": expected one of "twist", "bend", "taper"|got "twits"',
        edit([{**EDIT, "type": "twits"}]),
    ),
    Case(
        f"{RENDER} --edit edit.json",
        'edit 1 (twist): unknown key "angel" for a twist, expected only',
        edit([{**EDIT, "angel": 3}]),
    ),
    Case(
        f"{RENDER} --edit edit.json",
        'edit 1 (twist): key "angle_deg": expected a finite number of degrees, got NaN',
        edit([{**EDIT, "angle_deg": float("nan")}]),
    ),
    Case(
        f"{RENDER} --edit edit.json",
        'key "axis": expected "x", "y", "z" or a non-zero vector [x, y, z]|got [0, 0, 0]',
        edit([{**EDIT, "axis": [0, 0, 0]}]),
    ),
    Case(
        f"{RENDER} --edit edit.json",
        'edit 1 (scale): key "factor": expected a finite number above 0|got 0',
        edit([{"type": "scale", "factor": 0}]),
    ),
    Case(
        f"{RENDER} --edit edit.json",
        'key "extent": expected two finite numbers [lo, hi] with lo < hi|got [1, 1]',
        edit([{**EDIT, "extent": [1, 1]}]),
    ),
    Case(f"{RENDER} --cameras absent.json", "scene file absent.json: no such file; check the path"),
    Case(
        f"{RENDER} --cameras edit.json",
        "edit.json: expected a transforms file|got an edit file of pcore; give it with --edit",
    ),
    Case(f"{RENDER} --cameras {JSON} --scene absent", "scene absent: no such folder"),
    Case(f"{RENDER} --cameras {JSON} --split test", "expected one of --cameras, --split and"),
    Case(f"{RENDER} --split val", "no split 'val'; it has train, test"),
    Case(f"{RENDER} --split train --fov 30", "--fov is for orbits: leave out --split, or --fov"),
    Case(f"{RENDER} --split test --size 9 20", "--size: expected the shape of the images, which"),
    Case(f"{RENDER} --split test --size 0 0", "--size: expected the shape of the images, which"),
    Case(f"{RENDER} --cameras {JSON} --size -4 4", "width: expected a whole number of at least 1,"),
    Case(f"{RENDER} --orbit 0", "orbit: expected at least one camera, got 0"),
    Case(f"{RENDER} --orbit -3", "orbit: expected at least one camera, got -3"),
    Case(f"{RENDER} --orbit 2 --size 0 8", "expected a positive image size, got 0 x 8"),
    Case(f"{RENDER} --orbit 2 --fov 180", "--fov: expected degrees between 0 and 180, got 180"),
    Case(f"{RENDER} --orbit 2 --fov nan", "--fov: expected degrees between 0 and 180, got nan"),
    Case(f"{RENDER} --orbit 2 --elevation 91", "--elevation: expected degrees between -90 and 90"),
    Case(f"{RENDER} --orbit 2 --elevation nan", "--elevation: expected degrees between -90 and 90"),
    Case(f"{RENDER} --orbit 2 --factor -1", "down-scaling factor: expected a whole number of at"),
    Case(f"{RENDER} --orbit 2", "no run at run: expected a folder with a", gone("run/run.json")),
    Case(
        "render run/model.safetensors -o new --orbit 2",
        "model.safetensors is truncated, damaged or not a safetensors file|copy it again",
        cut("run/model.safetensors", 0.9),
    ),
    Case("render edit.json -o new --orbit 2", "edit.json is truncated, damaged or not a"),
    Case("render run -o ball --split test", "ball holds files already (test, train,|use another"),
    Case("render run -o run --split test", "run holds a run: expected a folder for pictures only;"),
    Case("render run -o edit.json --split test", "edit.json is a file: expected a folder for"),
    # --- eval and ablate
    Case("eval nowhere", "no run at nowhere"),
    Case(f"{EVAL} --state twist", "no state 'twist'; expected one of canonical, scale:S"),
    Case(f"{EVAL} --state scale:0", "state 'scale:0': expected scale:S with a factor S > 0, got"),
    Case(f"{EVAL} --state scale:nan", "state 'scale:nan': expected scale:S with a factor S > 0,"),
    Case(f"{EVAL} --factor 0", "down-scaling factor: expected a whole number of at least 1, got 0"),
    Case(f"{EVAL} --baseline ball", "no run at ball"),
    Case(f"{EVAL} -o mine", "mine holds other files (mine.txt): expected a new or", folder("mine")),
    Case(EVAL, "no split 'test'; it has train", gone("ball/transforms_test.json")),
    Case(EVAL, "no image at|put it there or remove the frame", gone("ball/test/r_1.png")),
    Case(EVAL, "meshes.npz: expected a NumPy archive of", text("ball/meshes.npz", "no archive")),
    Case(f"{ABLATE} --view -1", "--view: expected a number from 0 to 1, the test views of"),
    Case(f"{ABLATE} --view 2", "--view: expected a number from 0 to 1, the test views of scale:2,"),
    Case(f"{ABLATE} --steps 0", "expected steps >= 1, got 0"),
    Case(f"{ABLATE} --state all", "no deformed state to score; give --state scale:2"),
    Case(f"{ABLATE} -o mine", "mine holds other files (mine.txt): expected a new", folder("mine")),
    Case(
        ABLATE,
        "run is fine-tuned already: expected a pre-trained run|ablate the run that it was",
        keys("run/run.json", config={"base": "../other"}),
    ),
    # --- deform
    Case(DEFORM.replace("points.npy", "absent.npy"), "absent.npy: no such file; expected a .npy"),
    Case(DEFORM.replace("points.npy", "edit.json"), "edit.json: expected points (.npy, .ply) or"),
    Case(DEFORM.replace("new.npy", "new.obj"), "new.obj: expected a file of points that ends in"),
    Case(DEFORM.replace("new.npy", "points.npy"), "points.npy: expected an output other than the"),
    Case(DEFORM.replace("new.npy", "no/folder/new.npy"), "no/folder/new.npy: expected an existing"),
    Case(DEFORM, "edit.json: edit file not found; expected a JSON file", gone("edit.json")),
    Case(DEFORM, "new.npy: cannot write the points (Is a directory)", folder("new.npy")),
    Case(DEFORM, "points.npy: expected a NumPy array of numbers", text("points.npy", TRAP)),
    Case(
        DEFORM,
        "points.npy: expected a NumPy array of numbers (pickles are never read)",
        array("points.npy", np.array([Trap()], dtype=object)),
    ),
    Case(DEFORM, "points.npy: expected points of shape (N,", array("points.npy", np.zeros((4, 2)))),
    Case(DEFORM, "points.npy: expected finite", array("points.npy", np.full((4, 3), np.inf))),
    Case(DEFORM, "points.npy: expected at least one point,", array("points.npy", np.zeros((0, 3)))),
    Case(
        DEFORM.replace("points.npy", "p.ply"),
        "p.ply: expected at least one point, got none",
        text("p.ply", EMPTY_PLY),
    ),
    Case(
        DEFORM.replace("points.npy", "p.ply"),
        "p.ply: expected 5 of the PLY element 'vertex' as its header says, got 0",
        text("p.ply", EMPTY_PLY.replace(b" 0", b" 5")),
    ),
    Case(DEFORM, 'key "angle_deg": expected a finite', edit([{**EDIT, "angle_deg": 1e400}])),
    # --- import, info, demo, doctor
    Case(IMPORT.replace("model.pth", "absent.pth"), "absent.pth: expected the original's"),
    Case(IMPORT.replace("model.pth", "ball"), "ball: expected the original's model.pth, found a"),
    Case(IMPORT, "model.pth: expected a PyTorch file that holds nothing", text("model.pth", TRAP)),
    Case(IMPORT, "model.pth: expected a PyTorch file that holds nothing but", cut("model.pth")),
    Case(IMPORT, "model.pth: expected a PyTorch file that holds nothing", text("model.pth", b"")),
    Case(IMPORT, "lego.yml: cannot read the configuration|check the path", gone("lego.yml")),
    Case(IMPORT, "expected a YAML configuration of the original PAPR,", text("lego.yml", "a: [1")),
    Case(IMPORT, "expected a YAML mapping with sections such as dataset,", text("lego.yml", "- 1")),
    Case(IMPORT.replace("-o new", "-o run"), "run holds a run already|choose another folder with"),
    Case("import papr model.pth -o new", "--config|required"),
    Case("info nowhere", "no model at nowhere: expected a model.safetensors|check the path"),
    Case(
        "info edit.json",
        "edit.json: expected JSON, got text that does not parse|line 1",
        lambda world: (world / "edit.json").write_text('{"version": 2, "edits": ['),
    ),
    Case(
        "info empty",
        "no run at empty: expected a folder with a run.json",
        lambda world: (world / "empty").mkdir(),
    ),
    Case("info run", "model.safetensors is truncated, damaged", cut("run/model.safetensors", 0.3)),
    Case("info run", "run.json does not describe a run of pcore:", text("run/run.json", "[]")),
    Case(
        "info run",
        "state.pt is not a training state of pcore: expected the format 'pcore-state'; give",
        lambda world: torch.save({}, world / "run" / "state.pt"),
    ),
    Case("demo -o edit.json --device cpu", "edit.json is a file: expected a folder for the demo;"),
    Case("demo -o ball --device cpu", "ball holds other files|expected an empty place or the"),
    Case("demo -o new --device cpu --threads 0", "--threads: expected a whole number of at least"),
    Case("demo -o mine --device cpu", "mine/demo.json: expected the record of a", strange_demo),
    Case("doctor everything", "Unrecognized options: everything"),
    Case(
        "finetun run", "unknown command 'finetun': expected one of demo, check, train|did you mean"
    ),
]


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene, a run of it, an edit file, points, and an official checkpoint."""
    torch.manual_seed(0)
    world = tmp_path_factory.mktemp("original") / "world"
    write_scene(world / "ball")
    papr, cloud = write_run(world / "run", scene="../ball", config=CONFIG, preset="tiny")
    (world / "edit.json").write_text(json.dumps({"version": 2, "edits": [EDIT]}))
    save_points(world / "points.npy", torch.randn(9, 3))
    torch.save({"7": to_official_state(papr, cloud)}, world / "model.pth")
    (world / "lego.yml").write_text(yaml.safe_dump(OFFICIAL))
    return world


@pytest.fixture
def world(original: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy to be harmed, in which commands are called; without LPIPS weights."""
    for name in ("PCORE_LPIPS_DIR", "XDG_CACHE_HOME", "TORCH_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "empty"))
    monkeypatch.setenv("COLUMNS", "300")
    shutil.copytree(original, tmp_path / "world")
    monkeypatch.chdir(tmp_path / "world")
    return tmp_path / "world"


def content(world: Path) -> dict[str, bytes | None]:
    """All files by path, and folders."""
    return {
        str(path.relative_to(world)): path.read_bytes() if path.is_file() else None
        for path in sorted(world.rglob("*"))
    }


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_clear_error_and_nothing_lost(
    case: Case, world: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case.harm(world)
    before = content(world)
    assert main(case.command.split()) == 2
    error = capsys.readouterr().err
    after = content(world)
    assert [name for name in before if after.get(name, b"gone") != before[name]] == []
    assert sorted({*after} - {*before}) == []
    assert "Traceback" not in error
    for words in case.said.split("|"):
        assert words in error
