"""Pictures of the studio's page for its guide, taken in Chromium: docs/images/studio*.

Needs the extras `studio` and `dev`, and Chromium. The object is the embedded sample.
"""

from __future__ import annotations

import io
import shutil
import signal
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page as Tab
from playwright.sync_api import sync_playwright

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "studio"))

from page import Page  # noqa: E402

IMAGES = ROOT / "docs" / "images"
SIZE = {"width": 1200, "height": 700}
MIDDLE = (430, 350)
PORT = 8377


def picture(tab: Tab) -> Image.Image:
    """What the tab shows once its exact picture has come."""
    tab.wait_for_timeout(6_000)
    return Image.open(io.BytesIO(tab.screenshot())).convert("RGB")


def main() -> None:
    """Take both pictures."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    flags = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=flags)
        run = Path(folder) / "snail"
        shutil.copytree(ROOT / "src" / "pcore" / "studio" / "demo_run", run)
        page = Page(browser, run, PORT, ready=False)
        try:
            page.open(browser)
            page.tab.set_viewport_size(SIZE)
            page.tab.wait_for_timeout(2_000)
            # What Chromium says of a machine without a graphics card.
            page.tab.locator(".mantine-Notification-closeButton").first.click()
            page.click(MIDDLE, "Control")
            page.says("1 edit, not saved")
            page.drag(MIDDLE, (MIDDLE[0] - 10, MIDDLE[1] - 60))
            picture(page.tab).save(IMAGES / "studio.png", optimize=True)
            page.press("Add")
            page.says("2 edits")
            page.go_to("Select")
            page.tab.keyboard.press("b")
            page.shows("Brush (B)")
            page.drag((400, 420), (470, 430), (500, 400), key="Shift")
            page.says("points are selected")
            picture(page.tab).save(IMAGES / "studio-hands.webp", quality=85)
        finally:
            page.end(signal.SIGKILL)
        browser.close()


if __name__ == "__main__":
    main()
