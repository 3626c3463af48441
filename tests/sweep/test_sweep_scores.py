"""Scores come from the files that the verbs write."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from pcore.errors import InputError
from pcore.sweep.sweep_scores import notes_of, scores_of
from pcore.sweep.sweep_trial import Trial

CELL = {"psnr": {"value": "inf", "spread": None}, "ssim": {"value": 0.5, "spread": None}}
RECORD = {
    "notes": ["SC-GS, twist: failed"],
    "methods": [
        {"name": "PAPR", "setting": "given", "cells": {"canonical": CELL}},
        {"name": "SC-GS", "setting": "time", "cells": {"canonical": CELL}},
    ],
}


def compared(folder: Path) -> Trial:
    trial = Trial(
        scene="ball",
        setting="papr",
        seed=3,
        scene_folder=folder,
        folder=folder,
        verbs={"train": {}, "compare": {}},
        threads=1,
        device="cpu",
    )
    (folder / "compare").mkdir()
    (folder / "compare" / "compare.json").write_text(json.dumps(RECORD))
    return trial


def test_what_compare_wrote(tmp_path: Path) -> None:
    trial = compared(tmp_path)
    scores = scores_of([trial])
    assert [(one.method, one.seed, one.state) for one in scores] == [
        ("PAPR", 3, "canonical"),
        ("SC-GS (time)", 3, "canonical"),
    ]
    assert scores[0].scores == {"psnr": float("inf"), "ssim": 0.5}
    assert notes_of([trial]) == ["ball/papr/seed-3: SC-GS, twist: failed"]
    assert scores_of([replace(trial, verbs={"train": {}})]) == []


@pytest.mark.parametrize("text", ["", "[]", '{"methods": [{}]}'])
def test_damaged_results_are_named(tmp_path: Path, text: str) -> None:
    trial = compared(tmp_path)
    (tmp_path / "compare" / "compare.json").write_text(text)
    with pytest.raises(InputError, match=r"compare\.json: expected results"):
        scores_of([trial])
    with pytest.raises(InputError, match=r"summary"):
        scores_of([replace(trial, verbs={"train": {}, "eval": {}})])
