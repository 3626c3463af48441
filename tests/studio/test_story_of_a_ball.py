"""In Chromium: the ball of a gizmo, keys, a narrow window, a server that goes."""

import signal
from pathlib import Path
from typing import Any

import pytest
from page import Page, kept, until
from tests.forked import Forked

pytest.importorskip("viser", reason="the extra studio is not installed")

pytestmark = [pytest.mark.browser, pytest.mark.timeout(400)]
MIDDLE = (355, 350)
HANDLE = '.mantine-Paper-root[style*="position: fixed"] [style*="cursor: pointer"]'
"""What opens and closes the panel of a narrow window; the page itself presses it, too."""


def way(run: Path) -> list[float]:
    """How far the only handle is from where it was put."""
    one = kept(run)["edits"][0]["handles"][0]
    return [a - b for a, b in zip(one["to"], one["near"], strict=True)]


def reads(page: Page, number: str) -> None:
    """Wait until a number beside a slider is this."""
    page.tab.locator(f'input[value="{number}"]:visible').first.wait_for(timeout=30_000)


@pytest.mark.slow
def test_a_ball_a_telephone_and_a_lost_server(
    browser: Any, forked: Forked, run: Path, free_port: int
) -> None:
    page = Page(browser, forked, run, free_port)
    try:
        page.click(MIDDLE, "Control")
        page.says("1 edit, not saved")
        until(lambda: way(run) == [0.0, 0.0, 0.0])
        page.tab.wait_for_timeout(4000)
        # An arrow is before the ball here, and would take it along z alone.
        start = (MIDDLE[0], MIDDLE[1] - 6)
        page.drag(start, (start[0] + 50, start[1] - 10))
        until(lambda: way(run) != [0.0, 0.0, 0.0])
        x, y, z = way(run)
        # 50 pixels of 640, where all of the object is some 400 high: no farther, no nearer.
        assert 0.03 < min(x, y) < 0.35, "it goes where the pointer goes"
        assert 0 < z < 0.5 * min(x, y)

        page.press("Help")
        page.says("Keys and mouse")
        page.tab.keyboard.press("Escape")
        page.tab.get_by_text("Keys and mouse").wait_for(state="detached", timeout=30_000)

        page.go_to("View")
        page.tab.keyboard.press("c")
        reads(page, "0.5")
        page.go_to("Time")
        page.tab.wait_for_timeout(500)  # Until the tab has let the keyboard go.
        page.tab.keyboard.press("ArrowRight")
        reads(page, "0.02")

        page.tab.close()
        page.tab = browser.new_page(viewport={"width": 390, "height": 844}, has_touch=True)
        page.tab.goto(page.url)
        page.tab.get_by_text("Loading").wait_for(state="detached", timeout=60_000)
        # What is not there yet is hidden, too: first it must come, then be closed by the page.
        edits = page.tab.locator(".mantine-Tabs-root").first
        edits.wait_for(state="attached", timeout=60_000)
        edits.wait_for(state="hidden", timeout=30_000)
        page.tab.locator(HANDLE).first.tap()
        edit = page.tab.get_by_role("tab", name="Edit", exact=True)
        edit.wait_for(state="visible", timeout=30_000)
        assert page.problems == []

        page.server.end()
        page.says("The connection is lost.")
    finally:
        page.end(signal.SIGKILL)
