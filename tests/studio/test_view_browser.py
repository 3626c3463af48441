"""The page from a file, in Chromium, against pcore's own pictures."""

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from objects import TWIST, demo
from PIL import Image

from pcore.editing.animation import Animation
from pcore.geometry.orbit import orbit_around
from pcore.studio.recording import record
from pcore.studio.viewer_page import viewer_page

pytestmark = pytest.mark.browser
BARS = {0.0: 45.0, 0.5: 32.0, 1.0: 45.0}
"""PSNR in dB at shares of the film; at 0.5 between two moments, where motion is steady."""


def test_its_pictures_are_ours(browser: Any, tmp_path: Path) -> None:
    asset, animation = demo(), Animation(TWIST)
    frames = [asset.pose(animation, time=t) for t in torch.linspace(0, 1, 4).tolist()]
    path = tmp_path / "toy.html"
    path.write_bytes(viewer_page(record(asset, frames), title="toy").content)
    points = frames[0].points
    middle = (points.amin(dim=0) + points.amax(dim=0)) / 2
    camera = orbit_around(points, 3, size=(300, 300))[1]
    tab = browser.new_page(viewport={"width": 300, "height": 300})
    said: list[str] = []
    tab.on("console", lambda message: said.append(message.text))
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.on("request", lambda request: said.append(request.url) if "file:" not in request.url else 0)
    for time, bar in BARS.items():
        eye, at = (",".join(map(str, one.tolist())) for one in (camera.center, middle))
        tab.goto("about:blank")
        tab.goto(f"{path.as_uri()}#bare&time={time}&eye={eye}&at={at}")
        tab.wait_for_selector("body[data-state=ready]", timeout=30_000)
        shot = np.asarray(Image.open(io.BytesIO(tab.screenshot())).convert("RGB")) / 255
        own = asset.render(asset.pose(animation, time=time), camera).rgb.clamp(0, 1).numpy()
        assert own.min() < 0.5, "something is in the picture"
        assert -10 * math.log10(((shot - own) ** 2).mean()) > bar
    assert said == []
    tab.close()


def test_it_turns_and_plays(browser: Any, tmp_path: Path) -> None:
    asset, animation = demo(), Animation(TWIST)
    frames = [asset.pose(animation, time=t) for t in (0.0, 1.0)]
    path = tmp_path / "toy.html"
    path.write_bytes(viewer_page(record(asset, frames), title="toy", seconds=0.5).content)
    tab = browser.new_page(viewport={"width": 200, "height": 200})
    tab.goto(f"{path.as_uri()}#time=0")
    tab.wait_for_selector("body[data-state=ready]", timeout=30_000)
    first = tab.screenshot()
    tab.mouse.move(100, 90)
    tab.mouse.down()
    tab.mouse.move(150, 100, steps=2)
    tab.mouse.up()
    assert tab.screenshot() != first
    tab.keyboard.press("Space")
    for _ in range(50):  # Conditions in the page would need eval, which it forbids.
        tab.wait_for_timeout(100)
        if float(tab.input_value("#time")) > 0:
            break
    assert float(tab.input_value("#time")) > 0
    assert tab.text_content("#play") == "Pause"
    tab.close()


def test_without_webgl_it_says_so(browser: Any, tmp_path: Path) -> None:
    path = tmp_path / "toy.html"
    path.write_bytes(viewer_page(record(demo(), [demo().pose()]), title="toy").content)
    tab = browser.new_page()
    tab.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    tab.goto(path.as_uri())
    tab.wait_for_selector("body[data-state=failed]", timeout=30_000)
    assert "WebGL 2" in tab.text_content("#message")
    tab.close()
