"""The whole story in Chromium: handle, drag, undo, slider, freeze, key, film, save, recover."""

import signal
from pathlib import Path
from typing import Any

import pytest
import torch
from page import Page, kept, until
from tests.forked import Forked

import pcore
from pcore.cli.main import main

pytest.importorskip("viser", reason="the extra studio is not installed")

pytestmark = [pytest.mark.browser, pytest.mark.timeout(400)]


@pytest.mark.slow  # 84 s; its parts have tests of their own, and the story of hands its page.
def test_the_whole_story(browser: Any, forked: Forked, run: Path, free_port: int) -> None:
    page = Page(browser, forked, run, free_port)
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

        page.tab.locator('input[value="Twist"]').last.click()
        page.tab.keyboard.press("Control+a")
        page.tab.keyboard.type("left arm")
        until(lambda: kept(run)["edits"][1].get("name") == "left arm")
        page.says("2 · left arm")
        page.tab.locator('input[value="left arm"]').first.press("Enter")

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
        page.says("pcore animate")

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

    page = Page(browser, forked, run, free_port)
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
