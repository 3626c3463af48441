"""`torchrun ... pcore render|animate|eval|train`: two processes give what one gives."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from tests.seeded_runs import write_moving_edit
from toys import write_run, write_scene

from pcore.cli.main import main
from pcore.training.ranks import Ranks

pytestmark = [
    pytest.mark.skipif(not torch.distributed.is_available(), reason="torch without distributed"),
]

TWIST = {"type": "twist", "axis": "z", "angle_deg": 60}
WORDS = [
    "render run --split test --raw --edit twist.json -o {}/views",
    "render run --orbit 5 --frames --edit twist.json -o {}/orbit",
    "animate run --edit move.json --frames 3 --orbit --frames-dir {}/frames -o {}/film.mp4",
    "eval run --state scale:1.5 --factor 1 --pictures -o {}/eval",
    "train ball --steps 12 --points 60 --patches 2 --no-tensorboard --threads 1 -o {}/splats",
    "finetune run --preset tiny --steps 4 --patches 2 --no-tensorboard --threads 1 -o {}/tuned",
    "compare run --factor 1 --state scale:1.5 --methods papr aware -o {}/compare",
]
TRAINED = {"splats", "tuned"}
TIMED = {"run.json", "compare.csv", "compare.json", "compare.md"}


def calls(folder: str) -> list[list[str]]:
    return [[*words.format(folder, folder).split(), "--device", "cpu"] for words in WORDS]


def processes(folder: Path, code: str) -> list[subprocess.Popen[str]]:
    """Two of them, as torchrun would start them."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    about = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port}
    return [
        subprocess.Popen(
            [sys.executable, "-c", code],
            env={**os.environ, **about, "RANK": str(rank), "OMP_NUM_THREADS": "1"},
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for rank in range(2)
    ]


@pytest.fixture
def made(tmp_path: Path) -> Path:
    write_scene(tmp_path / "ball")
    write_run(tmp_path / "run", scene="../ball", factor=2)
    (tmp_path / "twist.json").write_text(json.dumps({"version": 2, "edits": [TWIST]}))
    write_moving_edit(tmp_path / "move.json")
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    """Files by name, but for what tells times or is packed anew each time."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not {"rows", *TRAINED} & {*path.parts} and path.name not in TIMED
    }


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_two_processes_draw_score_and_train_what_one_does(
    made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A port for each verb, as each start of torchrun has: a meeting that one of the two has not yet
    # left is none that the other may join.
    code = f"""import os
from pcore.cli.main import main
port = int(os.environ["MASTER_PORT"])
for number, one in enumerate({calls("two")}):
    os.environ["MASTER_PORT"] = str(port + number)
    assert main(one) == 0
"""
    (made / "two").mkdir()
    together = processes(made, code)
    told = [one.communicate(timeout=900)[0] for one in together]
    assert [one.returncode for one in together] == [0, 0], told
    assert told[1] == ""
    assert "protocol standard" in told[0]
    monkeypatch.chdir(made)
    (made / "one").mkdir()
    assert [main(one) for one in calls("one")] == [0] * len(WORDS)
    one, two = contents(made / "one"), contents(made / "two")
    assert {*one} == {*two}
    assert len(one) > 3 + 5 + 3 + 2
    assert [name for name in one if one[name] != two[name]] == []
    assert (made / "two" / "splats" / "gaussians.safetensors").exists()
    assert (made / "two" / "tuned" / "model.safetensors").exists()
    assert len([*(made / "two" / "compare" / "rows").iterdir()]) == 2


@pytest.mark.slow
def test_processes_that_were_given_different_things_say_so(made: Path) -> None:
    code = (
        "import os, sys; from pcore.cli.main import main; rank = os.environ['RANK']\n"
        "sys.exit(main(['render', 'run', '--orbit', '2' if rank == '0' else '3', '-o', 'out']))"
    )
    together = processes(made, code)
    told = [one.communicate(timeout=280)[0] for one in together]
    assert [one.returncode for one in together] == [2, 2], told
    assert "expected the same cameras in all of them" in told[0]
    assert not (made / "out").exists()


def test_alone_items_are_made_when_they_are_asked_for() -> None:
    made: list[int] = []
    items = Ranks().in_turn(3, lambda n: made.append(n) or n)
    assert next(items) == 0
    assert made == [0]
    assert [*items] == [1, 2]
