"""The whole story in Chromium: handle, drag, undo, slider, freeze, key, film, save, recover."""

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import pytest
import torch

import pcore
from pcore.cli.main import main

pytest.importorskip("viser", reason="the extra studio is not installed")

pytestmark = [pytest.mark.browser, pytest.mark.timeout(240)]


class Page:
    """A running `pcore studio` and a tab that shows it."""

    def __init__(self, browser: Any, run: Path, port: int) -> None:
        command = [sys.executable, "-m", "pcore.cli.main", "studio", str(run), "--port", str(port)]
        self.server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.server.stdout is not None
        self.url = self.server.stdout.readline().strip()
        self.tab = browser.new_page(viewport={"width": 1000, "height": 640})
        self.problems: list[str] = []
        self.tab.on("pageerror", lambda error: self.problems.append(str(error)))
        self.tab.goto(self.url)
        self.says("points")
        self.tab.wait_for_timeout(2500)  # The first picture: pointers are ignored before it.

    def says(self, text: str) -> None:
        self.tab.get_by_text(text).first.wait_for(timeout=30_000)

    def press(self, name: str) -> None:
        self.tab.get_by_role("button", name=name, exact=True).click()

    def go_to(self, name: str) -> None:
        self.tab.get_by_role("tab", name=name, exact=True).click()

    def fill(self, label: str, value: str) -> None:
        """Type into the number beside a label."""
        row = self.tab.get_by_text(label, exact=True).locator("xpath=../../..")
        field = row.locator("input:visible").last
        field.fill(value)
        field.press("Enter")
        self.tab.wait_for_timeout(400)

    def drag(self, start: tuple[int, int], end: tuple[int, int], key: str | None = None) -> None:
        mouse, keyboard = self.tab.mouse, self.tab.keyboard
        if key:
            keyboard.down(key)
        mouse.move(*start)
        mouse.down()
        for step in range(1, 7):
            share = step / 6
            mouse.move(*(round(a + (b - a) * share) for a, b in zip(start, end, strict=True)))
            self.tab.wait_for_timeout(80)
        mouse.up()
        if key:
            keyboard.up(key)
        self.tab.wait_for_timeout(600)

    def end(self, how: signal.Signals) -> int:
        """End the server and the tab; return its exit code."""
        self.server.send_signal(how)
        assert self.server.stdout is not None
        with self.server.stdout:
            code = self.server.wait(20)
        self.tab.close()
        return code


def until(holds: Callable[[], Any], seconds: float = 30.0) -> None:
    """Wait for something that another process does."""
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.1)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    with as_file(files("pcore.studio").joinpath("demo_run")) as source:
        return Path(shutil.copytree(source, tmp_path / "run"))


def kept(run: Path) -> dict[str, Any]:
    content = json.loads((run / "studio" / "autosave.json").read_text())
    label, number, _ = content["commands"][content["now"]]
    return {"label": label, **content["edits"][number]}


def test_the_whole_story(browser: Any, run: Path, free_port: int) -> None:
    page = Page(browser, run, free_port)
    middle = (355, 350)
    try:
        page.tab.keyboard.down("Control")
        page.tab.mouse.click(*middle)
        page.tab.keyboard.up("Control")
        page.says("1 edit, not saved")
        page.tab.wait_for_timeout(1500)
        placed = kept(run)["edits"][0]["handles"][0]
        page.drag(middle, (middle[0] - 60, middle[1] - 60))
        until(lambda: kept(run)["edits"][0]["handles"][0]["to"] != placed["to"])
        page.tab.keyboard.press("Control+z")
        until(lambda: kept(run)["edits"][0]["handles"][0]["to"] == placed["to"])

        page.press("Add")
        page.says("2 edits")
        page.fill("Angle", "30")
        until(lambda: kept(run)["edits"][1].get("angle_deg") == 30)

        page.drag((200, 420), (520, 520), key="Shift")
        page.go_to("Select")
        page.says("are selected")
        page.press("Freeze selection")
        until(lambda: kept(run).get("freeze"))

        page.go_to("Time")
        page.press("Key selected edit")
        until(lambda: "keyframes" in str(kept(run)["edits"][1]["angle_deg"]))
        page.fill("At", "1")
        page.go_to("Edit")
        page.fill("Angle", "20")
        until(lambda: len(kept(run)["edits"][1]["angle_deg"]["keyframes"]) == 2)

        page.go_to("Files")
        page.press("Save")
        edit = run / "studio" / "edit.json"
        until(edit.is_file)
        page.fill("Picture width", "64")
        page.press("Screenshot")
        picture = run / "studio" / "picture_001.png"
        until(picture.is_file)
        page.fill("Frames", "4")
        page.press("Film")
        until((run / "studio" / "film_001.mp4").is_file)
        page.says("Wrote film_001.mp4")

        words = ["render", str(run), "--edit", str(edit), "--time", "1"]
        words += ["--cameras", str(picture.with_suffix(".json")), "-o", str(run / "out")]
        assert main(words) == 0
        assert next((run / "out").glob("*.png")).read_bytes() == picture.read_bytes()

        page.tab.reload()
        page.says("2 edits, saved")
        page.go_to("Edit")
        page.press("Add")
        page.says("3 edits, not saved")
        until(lambda: len(kept(run)["edits"]) == 3)
        assert page.problems == []
    finally:
        page.end(signal.SIGKILL)

    page = Page(browser, run, free_port)
    try:
        page.press("Restore")
        page.says("3 edits, not saved")
        page.tab.keyboard.press("Control+z")
        page.says("2 edits")
        page.press("Save")
        page.says("2 edits, saved")
        saved = pcore.load(run).pose(edit, time=1.0).points
        assert not torch.equal(saved, pcore.load(run).points)
    finally:
        assert page.end(signal.SIGINT) == 0
