"""Films and time of a whole page whose tab is not a browser."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from objects import TWIST, demo

from pcore.cli.studio import StudioCommand, _ending
from pcore.geometry.orbit import orbit_around
from pcore.studio.camera_keys import keys_file
from pcore.studio.guard import Guard
from pcore.studio.outputs import Outputs

pytest.importorskip("viser", reason="the extra studio is not installed")
pytest.importorskip("av", reason="the extra video is not installed")
from pcore.studio.studio import Studio

NEAR, FAR = orbit_around(demo().points, size=(16, 16), count=2)


def opened(folder: Path, port: int) -> Studio:
    outputs = Outputs(folder=folder / "studio", edit=folder / "edit.json", run=folder)
    return Studio(demo(), Guard(port=port), outputs, title="demo")


@pytest.fixture
def page(tmp_path: Path, free_port: int) -> Iterator[Studio]:
    with closing(opened(tmp_path, free_port)) as studio:
        studio.editor.session.do(TWIST["edits"][0])
        yield studio


def tab(camera: Any) -> Any:
    return SimpleNamespace(camera=lambda **_: camera, number=1)


def do(page: Studio, what: Any) -> None:
    page.perform(what)
    assert page.worker.wait(60)


def test_commands_go_on_while_a_film_is_written(page: Studio, tmp_path: Path) -> None:
    frames: list[Any] = []
    page.panels.progress = lambda share: frames.append(share)  # type: ignore[method-assign]

    def film() -> None:
        page.files.film(tab(NEAR), 12, 16)
        page.perform(lambda: frames.append("command"))
        page.perform(lambda: page.files.film(tab(NEAR), 3, 16))

    do(page, film)
    assert frames.index("command") < 3
    assert frames[-1] is None
    assert len(frames) == 2 * 12 + 2
    assert [path.name for path in (tmp_path / "studio").glob("film*.mp4")] == ["film_001.mp4"]
    assert "pcore animate" in page.files.line
    do(page, lambda: page.files.film(tab(NEAR), 2000, 16) or page.files.stop())
    assert len(list((tmp_path / "studio").glob("film*"))) == 2, "one film and its cameras"


def test_camera_keys_are_saved_and_read_again(page: Studio, tmp_path: Path, free_port: int) -> None:
    do(page, lambda: page.files.camera_key(tab(NEAR), "Key"))
    page.editor.at(0.75)
    do(page, lambda: page.files.camera_key(tab(FAR), "Key"))
    do(page, lambda: page.files.save("edit.json"))
    assert keys_file(tmp_path / "edit.json").is_file()
    page.close()
    with closing(opened(tmp_path, free_port)) as again:
        assert [time for time, _ in again.files.cameras] == [0.0, 0.75]
        do(again, lambda: again.files.camera_key(tab(None), "Clear"))
        do(again, lambda: again.files.open("edit.json"))
        assert len(again.files.cameras) == 2


def test_play_moves_the_slider_and_shows_quick_states(page: Studio) -> None:
    do(page, lambda: page.actions._pass(0.4))
    assert page.panels._w.time.value == pytest.approx(0.4)
    assert page.editor.raw(0)["angle_deg"] == pytest.approx(20.0)


def test_the_demo_says_that_nothing_of_it_stays() -> None:
    assert "is gone then" in _ending(StudioCommand(demo=True))
    assert "only what is saved in mine.json" in _ending(
        StudioCommand(demo=True, edit=Path("mine.json"))
    )
    assert _ending(StudioCommand(run_or_file=Path("r"))).endswith("what is not saved is kept")
