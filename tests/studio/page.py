"""A running `pcore studio` and a tab that shows it, for tests in Chromium."""

import contextlib
import json
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.forked import Forked

KNOWN = "Unable to preventDefault inside passive event listener"
"""What viser's own page says on the console when something is dragged; all else is a problem."""


STUDIO = "import sys; from pcore.cli.main import main; sys.exit(main(sys.argv[1:]))"


class Page:
    """A running `pcore studio` and a tab that shows it."""

    def __init__(
        self, browser: Any, forked: Forked, run: Path, port: int, *, ready: bool = True
    ) -> None:
        words = ["studio", str(run), "--port", str(port)]
        self.server = forked.start(STUDIO, *words, said=run.parent / f"said-{time.time_ns()}")
        self.url = self.server.says_line("http").strip()
        self.problems: list[str] = []
        self.tab: Any = None
        if ready:
            self.open(browser)

    def open(self, browser: Any, **options: Any) -> None:
        """Show the page in a new tab, until its first picture: before it pointers do nothing."""
        self.tab = browser.new_page(viewport={"width": 1000, "height": 640}, **options)
        self.tab.on("pageerror", lambda error: self.problems.append(str(error)))
        self.tab.on("console", self._heard)
        self.tab.goto(self.url)
        self.says("points")
        self.tab.get_by_text("Loading").wait_for(state="detached", timeout=60_000)
        self.tab.wait_for_timeout(800)

    def _heard(self, message: Any) -> None:
        if message.type == "error" and KNOWN not in message.text:
            self.problems.append(message.text)

    def says(self, text: str) -> None:
        self.tab.get_by_text(text).first.wait_for(timeout=30_000)

    def shows(self, value: str) -> None:
        """Wait until a field holds a value, and what belongs to it has arrived."""
        self.tab.locator(f'input[value="{value}"]').first.wait_for(timeout=30_000)
        self.tab.wait_for_timeout(400)

    def press(self, name: str) -> None:
        self.tab.get_by_role("button", name=name, exact=True).click()

    def go_to(self, name: str) -> None:
        self.tab.get_by_role("tab", name=name, exact=True).click()

    def choose(self, label: str, option: str) -> None:
        """Take an option of the list beside a label."""
        row = self.tab.get_by_text(label, exact=True).locator("xpath=../../..")
        row.locator("input:visible").last.click()
        self.tab.get_by_role("option", name=option, exact=True).click()

    def click(self, place: tuple[int, int], key: str) -> None:
        """Click with a key held."""
        self.tab.keyboard.down(key)
        self.tab.mouse.click(*place)
        self.tab.keyboard.up(key)

    def fill(self, label: str, value: str) -> None:
        """Type into the number beside a label."""
        row = self.tab.get_by_text(label, exact=True).locator("xpath=../../..")
        field = row.locator("input:visible").last
        field.fill(value)
        field.press("Enter")
        self.tab.wait_for_timeout(400)

    def drag(
        self,
        start: tuple[int, int],
        *ends: tuple[int, int],
        key: str | None = None,
        hold: bool = False,
    ) -> None:
        mouse, keyboard = self.tab.mouse, self.tab.keyboard
        if key:
            keyboard.down(key)
        mouse.move(*start)
        mouse.down()
        for end in ends:
            for step in range(1, 7):
                share = step / 6
                mouse.move(*(round(a + (b - a) * share) for a, b in zip(start, end, strict=True)))
                self.tab.wait_for_timeout(80)
            start = end
        if hold:
            return
        mouse.up()
        if key:
            keyboard.up(key)
        self.tab.wait_for_timeout(600)

    def end(self, how: signal.Signals) -> int:
        """End the server and the tab; return its exit code."""
        code = self.server.end(how)
        if self.tab is not None:
            self.tab.close()
        return code


def until(holds: Callable[[], Any], seconds: float = 60.0) -> None:
    """Wait for something that another process does."""
    end = time.monotonic() + seconds
    while True:
        # An edit that is not kept yet is not in the file, either.
        with contextlib.suppress(IndexError):
            if holds():
                return
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.1)


def kept(run: Path) -> dict[str, Any]:
    content = json.loads((run / "studio" / "autosave.json").read_text())
    label, number, _ = content["commands"][content["now"]]
    return {"label": label, **content["edits"][number]}
