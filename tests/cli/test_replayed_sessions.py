"""What a hand did in a session, saved and drawn by the command line: the same picture."""

from __future__ import annotations

import json
import random
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tests.cli.toys import toy_cameras, write_run
from tests.editing.test_commands import at_random

import pcore
from pcore.asset.asset import Asset
from pcore.capture.load import load_cameras
from pcore.cli.main import main
from pcore.data.camera_output import save_transforms
from pcore.data.pictures import to_bytes
from pcore.editing.session import EditSession

SIZE, COMMANDS = 32, 12


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("replayed")
    torch.manual_seed(5)
    write_run(folder / "run", points=80, factor=1)
    camera = toy_cameras(1)[0].resized(SIZE, SIZE)
    save_transforms(folder / "run" / "camera.json", [("view", camera)])
    return folder / "run"


@pytest.fixture(scope="module")
def asset(run: Path) -> Asset:
    return pcore.load(run, device="cpu")


def played(asset: Asset, seed: int) -> EditSession:
    made, draw = asset.session(), random.Random(seed)
    for _ in range(COMMANDS):
        at_random(made, draw)
    return made


def check(asset: Asset, run: Path, folder: Path, seed: int) -> bool:
    """Whether a sequence, which ends with edits or not, is drawn alike by both."""
    made = played(asset, seed)
    made.save(folder / "edit.json")
    ((_, camera),) = load_cameras(run / "camera.json")
    rays = made.state.rays
    expected = to_bytes(asset.render(asset.pose(made, rays=rays), camera).rgb).numpy()
    assert expected.std() > 1, "nothing is to be seen"
    words = ["--edit", folder / "edit.json", "--cameras", run / "camera.json", "--rays", rays]
    words += ["--time", made.time] if made.stack.animated else []
    words += ["-o", folder / "out", "--overwrite", "--device", "cpu", "--threads", "1"]
    assert main(["render", str(run), *map(str, words)]) == 0
    (file,) = (folder / "out").glob("*.png")
    with Image.open(file) as image:
        assert np.array_equal(np.asarray(image)[..., :3], expected), f"sequence {seed}"
    return bool(json.loads((folder / "edit.json").read_text())["edits"])


@pytest.mark.parametrize("seed", range(10))
def test_a_saved_session_is_the_same_picture_on_the_command_line(
    asset: Asset, run: Path, tmp_path: Path, seed: int
):
    check(asset, run, tmp_path, seed)


@pytest.mark.slow
def test_two_hundred_saved_sessions_are(asset: Asset, run: Path, tmp_path: Path):
    edited = [check(asset, run, tmp_path, seed) for seed in range(10, 210)]
    assert sum(edited) > 100, "most are to end with edits"
