"""Hands in Chromium: strokes, pins, locks, numbers, a formula's gizmo, a cage, a tab that goes."""

import shutil
import signal
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import pytest
from page import Page, kept, until
from tests.forked import Forked

pytest.importorskip("viser", reason="the extra studio is not installed")

pytestmark = [pytest.mark.browser, pytest.mark.timeout(400)]
MIDDLE = (355, 350)


def without_webgl(browser: Any, url: str) -> None:
    """A browser that cannot show anything says why."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    flags = ["--disable-gpu", "--disable-3d-apis"]
    bare = browser.browser_type.launch(executable_path=program, args=flags)
    try:
        tab = bare.new_page()
        tab.goto(url)
        tab.get_by_text("WebGL is unavailable").first.wait_for(timeout=30_000)
    finally:
        bare.close()


@pytest.mark.slow
def test_hands_on_the_page(browser: Any, forked: Forked, run: Path, free_port: int) -> None:
    page = Page(browser, forked, run, free_port)
    keys = page.tab.keyboard
    try:
        # A lasso, kept by a name, and a brush that paints on.
        page.go_to("Select")
        keys.press("l")
        page.shows("Lasso (L)")
        page.drag((200, 150), (480, 150), (480, 330), (200, 330), key="Shift")
        page.says("points are selected")
        page.fill("Name", "top")
        page.press("Keep the selection")
        until((run / "studio" / "selections" / "top.npy").is_file)
        page.press("Clear")
        page.says("Nothing is selected.")
        keys.press("b")
        page.shows("Brush (B)")
        page.drag((330, 330), (380, 380), key="Shift")
        page.says("points are selected")
        page.press("Clear")
        page.says("Nothing is selected.")
        keys.press("g")
        page.shows("Ball on the surface (G)")
        page.drag(MIDDLE, (400, 370), key="Shift")
        page.says("points are selected")
        page.press("Clear")

        # A handle that moves along one axis, then by numbers; a pin.
        page.go_to("Edit")
        page.click(MIDDLE, "Control")
        page.says("1 edit, not saved")
        until((run / "studio" / "autosave.json").is_file)
        start = kept(run)["edits"][0]["handles"][0]["to"]
        keys.press("z")
        page.shows("z")
        page.drag(MIDDLE, (MIDDLE[0] - 30, MIDDLE[1] - 60))
        until(lambda: kept(run)["edits"][0]["handles"][0]["to"] != start)
        to = kept(run)["edits"][0]["handles"][0]["to"]
        assert to[:2] == pytest.approx(start[:2], abs=1e-9)
        assert to[2] > start[2]
        keys.press("z")
        page.fill("Handle", "0.25")
        until(lambda: kept(run)["edits"][0]["handles"][0]["to"][2] == pytest.approx(0.25))
        page.click((250, 260), "Alt")
        until(lambda: len(kept(run)["edits"][0]["handles"]) == 2)
        pin = kept(run)["edits"][0]["handles"][1]
        assert pin["near"] == pin["to"]

        # A twist in the kept selection, whose centre is dragged.
        page.press("Add")
        page.says("2 edits")
        page.choose("Acts in", "top")
        until(lambda: "region" in kept(run)["edits"][1])
        origin = kept(run)["edits"][1]["origin"]
        page.fill("Centre", "0.1")
        until(lambda: kept(run)["edits"][1]["origin"][2] == pytest.approx(0.1))
        assert kept(run)["edits"][1]["origin"][:2] == pytest.approx(origin[:2])

        # A cage: its file lies in the folder of the page.
        page.choose("New edit", "Cage")
        page.press("Add")
        page.says("3 edits")
        until(lambda: len(kept(run)["edits"]) == 3)
        cage = kept(run)["edits"][2]
        assert Path(cage["before"]) == run / "studio" / "cage_001.ply"
        assert len(cage["after"]) >= 8
        page.press("Save")
        page.says("3 edits, saved")

        # A tab that goes in the middle of a drag has not let go.
        page.press("1 · Handles")
        page.tab.wait_for_timeout(800)
        before = kept(run) if (run / "studio" / "autosave.json").is_file() else None
        page.drag(MIDDLE, (420, 300), hold=True)
        page.tab.close()
        page.open(browser)
        page.says("3 edits, saved")
        assert (kept(run) if (run / "studio" / "autosave.json").is_file() else None) == before
        assert page.problems == []
        page.tab.close()
        without_webgl(browser, page.url)
    finally:
        page.end(signal.SIGKILL)


def test_a_dark_browser_and_points(browser: Any, forked: Forked, run: Path, free_port: int) -> None:
    page = Page(browser, forked, run, free_port, ready=False)
    try:
        page.open(browser, color_scheme="dark")
        panel = 'document.documentElement.getAttribute("data-mantine-color-scheme")'
        page.tab.wait_for_function(f'{panel} === "dark"', timeout=30_000)
        page.go_to("View")
        page.choose("While moving", "points")
        row = page.tab.get_by_text("Exact when it rests", exact=True).locator("xpath=../../..")
        row.locator("input").last.click()
        page.tab.wait_for_timeout(2500)
        picture = iio.imread(page.tab.screenshot())[:, :600, :3]
        assert 0.05 < float((picture.min(axis=2) < 200).mean()) < 0.6  # The snail, by points.
        page.click((355, 350), "Control")
        page.says("1 edit, not saved")
        page.go_to("Edit")
        reach = page.tab.get_by_text("Reach", exact=True).locator("xpath=../../..")
        before = float(reach.locator("input:visible").last.input_value())
        page.tab.mouse.move(500, 500)
        page.tab.keyboard.down("Shift")
        page.tab.mouse.wheel(0, -100)
        page.tab.keyboard.up("Shift")
        until(lambda: float(reach.locator("input:visible").last.input_value()) > before)
        page.tab.keyboard.press("t")
        page.tab.wait_for_function(f'{panel} === "light"', timeout=30_000)
        assert page.problems == []
    finally:
        page.end(signal.SIGKILL)
