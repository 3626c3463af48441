"""Films go through keys at their times, step by step, and the command line makes them again."""

import json
import shlex
from pathlib import Path

import pytest
import torch
from objects import TWIST, demo

from pcore.cli.main import main
from pcore.editing.animation import Animation
from pcore.editing.stack import Stack
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_around
from pcore.render.picture import RenderCancelledError
from pcore.studio.camera_keys import keys_file, read_keys, write_keys
from pcore.studio.filming import Film
from pcore.studio.outputs import write_cameras

pytest.importorskip("av", reason="the extra video is not installed")

STACK = Stack.of(Animation(TWIST))


def cameras(count: int = 4) -> list[Camera]:
    return orbit_around(demo().points, size=(32, 32), count=count)


def test_cameras_are_where_their_keys_say() -> None:
    first, second, *_ = cameras()
    film = Film.of(demo(), STACK, [(0.0, first), (3.0, second)], 7, light=None)
    assert film.times == (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
    assert film.span == (0.0, 3.0)
    late = Film.of(demo(), STACK, [(0.5, first), (0.75, second)], 5, light=None)
    assert late.span is None
    for camera, expected in zip(late.cameras, (first, first, first, second, second), strict=True):
        torch.testing.assert_close(
            camera.world_from_camera, expected.world_from_camera, rtol=0, atol=1e-6
        )
    assert len(Film.of(demo(), STACK, [(9.0, second)], 5, light=None).cameras) == 1


def test_a_film_that_is_stopped_leaves_nothing(tmp_path: Path) -> None:
    film, done = Film.of(demo(), STACK, [(0.0, cameras()[0])], 4, light=None), list[float]()
    path = tmp_path / "film.mp4"
    with pytest.raises(RenderCancelledError):
        done.extend(film.write(path, lambda: len(done) == 6))
    assert len(done) == 6, "four poses and two pictures"
    assert list(tmp_path.iterdir()) == []


def test_the_command_makes_the_same_film(run: Path, tmp_path: Path) -> None:
    first, second, *_ = cameras()
    edit, file, video = (tmp_path / name for name in ("e d.json", "film.json", "film.mp4"))
    edit.write_text(json.dumps(TWIST))
    film = Film.of(demo(), STACK, [(0.5, first), (1.5, second)], 4, light="baked")
    shares = list(film.write(video, lambda: False))
    assert shares[-1] == pytest.approx(1.0)
    assert shares == sorted(shares)
    write_cameras(file, film.cameras)
    program, *words = shlex.split(film.line(run, edit=edit, cameras=file))
    assert program == "pcore"
    assert main([*words[:-1], str(tmp_path / "again.mp4")]) == 0
    assert (tmp_path / "again.mp4").read_bytes() == video.read_bytes()


def test_camera_keys_lie_beside_the_edit_file(tmp_path: Path) -> None:
    edit = tmp_path / "edit.json"
    write_keys(edit, [])
    assert read_keys(edit) == []
    assert not keys_file(edit).exists()
    first, second, *_ = cameras()
    write_keys(edit, [(0.0, first), (0.4, second)])
    (_, one), (time, other) = read_keys(edit)
    assert time == 0.4
    assert torch.equal(one.world_from_camera, first.world_from_camera)
    assert other.focal == second.focal
    write_keys(edit, [])
    assert read_keys(edit) == []
    keys_file(edit).write_text('{"frames": [{"time": 0}]}')
    with pytest.raises(InputError, match=r"edit\.cameras\.json: expected camera keys"):
        read_keys(edit)
