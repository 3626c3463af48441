"""The study's page in a browser: chosen by keys and mouse, reloaded, saved."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pcore.study.answers import read_answers, read_key
from pcore.study.page import QUESTION, write_study
from pcore.study.trials import plan_study

pytestmark = pytest.mark.browser


def write_pictures(root: Path) -> dict[str, Path]:
    folders = {name: root / name for name in ("ours", "papr")}
    for number, folder in enumerate(folders.values()):
        folder.mkdir()
        for item in range(3):
            pixels = np.full((60, 80, 3), 255, np.uint8)
            pixels[10:50, 10:70] = 90 * number + 30 * item
            Image.fromarray(pixels).save(folder / f"{item}.png")
    return folders


def test_a_person_goes_through_it(tmp_path: Path, browser: Any) -> None:
    study = plan_study(write_pictures(tmp_path), catch=1)
    write_study(tmp_path, study, question=QUESTION, per_person=2)
    with browser.new_context(
        viewport={"width": 1000, "height": 700}, accept_downloads=True
    ) as context:
        page = context.new_page()
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto((tmp_path / "study.html").as_uri())
        assert page.inner_text("#total") == "3"
        page.click("#start")
        assert page.inner_text("#count") == "1 of 3"
        # Pictures are decoded after the click.
        images = "[...document.querySelectorAll('.choice img')]"
        page.wait_for_function(f"{images}.every(i => i.complete && i.width > 0)")
        sizes = page.evaluate(f"{images}.map(i => i.width)")
        assert len(sizes) == 2
        assert min(sizes) > 300
        page.keyboard.press("ArrowLeft")
        page.click("#right")
        assert page.inner_text("#count") == "3 of 3"
        page.keyboard.press("Backspace")
        assert page.inner_text("#count") == "2 of 3"
        page.reload()
        assert page.inner_text("#start") == "Go on"
        page.click("#start")
        assert page.inner_text("#count") == "2 of 3"
        page.keyboard.press("ArrowRight")
        page.keyboard.press("ArrowRight")
        with page.expect_download() as download:
            page.click("#save")
        answers = tmp_path / "answers.json"
        download.value.save_as(answers)
        assert json.loads(page.input_value("#text")) == json.loads(answers.read_text())
        page.click("#next button")
        assert page.inner_text("#start") == "Begin"
        page.click("#start")
        assert page.inner_text("#count") == "1 of 3"
        for _ in range(3):
            page.keyboard.press("ArrowLeft")
        second = json.loads(page.input_value("#text"))
    assert errors == []
    (person,) = read_answers([answers], read_key(tmp_path / "key.json"), caught=0.0).people
    assert [one.chosen == one.left for one in person.answers] == [True, False, False]
    assert person.asked == 3
    assert second["person"] != person.person
    assert len(second["answers"]) == 3
