"""The paper's tables: means that miss nothing, and quoted figures that say so."""

from __future__ import annotations

from typing import Any

from benchmarks.paper import TABLES, ours, text_of


def record(**states: float | None) -> dict[str, Any]:
    cells = {
        state: {"psnr": {"value": value}, "ssim": {"value": 0.9}, "lpips_alex": {"value": None}}
        for state, value in states.items()
    }
    kinds = {"canonical": "canonical", "twist": "analytic", "bend": "analytic", "run": "skeletal"}
    line = {"name": "PAPR", "setting": "given", "cells": cells, "cost": {"primitives": 3000}}
    return {"about": {"kinds": kinds}, "methods": [line]}


def test_means_are_over_states_of_the_kind_and_objects() -> None:
    two = [record(canonical=40.0, twist=20.0, bend=22.0), record(twist=30.0, bend=32.0)]
    assert ours(two, ["analytic"]) == [("PAPR (given)", (26.0, 0.9, None, "3,000"))]
    # A mean over fewer states than another method's would compare unlike things.
    assert ours([record(twist=20.0)], ["analytic"])[0][1][0] is None


def test_quoted_figures_say_so() -> None:
    table = TABLES["main"]
    lines = text_of(table, ours([record(twist=20.0, bend=22.0)], table.kinds), ["toy"]).splitlines()
    assert "| PAPR (given) | 21.00 | 0.900 | - | 3,000 |" in lines
    assert "| SC-GS - QUOTED, Neural Editor | 18.55 | 0.832 | 0.123 | 236K |" in lines
    assert sum("QUOTED" in line for line in lines) == 12
