"""Means, gains, and their files."""

import csv
import json
import math
import re
from pathlib import Path
from typing import get_args

import pytest

from pcore.errors import InputError
from pcore.evaluation.contest import Cost
from pcore.evaluation.contest_tables import METRICS
from pcore.evaluation.health import HEALTH
from pcore.evaluation.protocol import ImageScores, Perceptual
from pcore.evaluation.runner import ImageRow, Value
from pcore.evaluation.states import Kind
from pcore.evaluation.summary import Gain, gains, state_means
from pcore.evaluation.tables import read_summary, shown, summary_record, write_tables
from pcore.metrics.geometry_metrics import GeometryScores
from pcore.metrics.trunks import TrunkName

NAMES: dict[str, Kind] = {"canonical": "canonical", "twist": "analytic", "bend": "analytic"}


def row(method: str, state: str, view: str = "r_0", **scores: Value) -> ImageRow:
    kind = NAMES.get(state, "skeletal")
    return ImageRow(
        method=method, state=state, kind=kind, protocol="standard", view=view, scores=scores
    )


def rows_of(method: str, **states: tuple[float, float]) -> list[ImageRow]:
    """Rows of one view per state from (foreground PSNR, hole rate)."""
    return [
        row(method, state, foreground_psnr=psnr, psnr=psnr + 10, hole_rate=holes)
        for state, (psnr, holes) in states.items()
    ]


def gain_of(rows: list[ImageRow]) -> Gain:
    (found,) = gains(state_means(rows), "PAPR")
    return found


BASE = rows_of("PAPR", canonical=(30.0, 0.01), twist=(24.0, 0.11), bend=(20.0, 0.21))


def test_gains_by_their_formulas() -> None:
    tuned = rows_of("P-CORE", canonical=(29.7, 0.02), twist=(27.0, 0.03), bend=(23.0, 0.05))
    gain = gain_of(BASE + tuned)
    assert gain.states == ("twist", "bend")
    assert gain.lost == pytest.approx(8.0)
    assert gain.gain == pytest.approx(3.0)
    assert gain.recovered == pytest.approx(3 / 8)
    assert gain.baseline_holes == pytest.approx(0.15)
    assert gain.method_holes == pytest.approx(0.03)  # against PAPR's canonical rate, not its own
    assert gain.holes_removed == pytest.approx(0.8)
    assert gain.canonical_loss == pytest.approx(0.3)
    assert gain.canonical_loss_full == pytest.approx(0.3)


def test_nothing_lost_is_nothing_to_recover() -> None:
    base = rows_of("PAPR", canonical=(30.0, 0.1), twist=(31.0, 0.1))
    gain = gain_of(base + rows_of("P-CORE", canonical=(30.0, 0.1), twist=(32.0, 0.1)))
    assert gain.gain == pytest.approx(1.0)
    assert gain.recovered is None
    assert gain.holes_removed is None


def test_infinite_and_missing_figures_make_no_claims() -> None:
    base = [
        row("PAPR", "canonical", foreground_psnr=math.inf, hole_rate=None),
        row("PAPR", "twist", foreground_psnr=20.0, hole_rate=None),
    ]
    tuned = [
        row("P-CORE", "canonical", foreground_psnr=math.inf, hole_rate=None),
        row("P-CORE", "twist", foreground_psnr=21.0, hole_rate=None),
    ]
    gain = gain_of(base + tuned)
    assert gain.gain == pytest.approx(1.0)
    assert gain.recovered is None
    assert gain.canonical_loss is None
    assert gain.baseline_holes is None


def test_groups_follow_the_kind_of_the_states_not_their_names() -> None:
    base = rows_of("PAPR", canonical=(30.0, 0.0), twist=(20.0, 0.2), run=(25.0, 0.1))
    tuned = rows_of("P-CORE", canonical=(30.0, 0.0), twist=(22.0, 0.2), run=(26.0, 0.1))
    found = gains(state_means(base + tuned), "PAPR")
    assert [(g.group, g.states, g.gain) for g in found] == [
        ("analytic", ("twist",), pytest.approx(2.0)),
        ("skeletal", ("run",), pytest.approx(1.0)),
    ]


def test_means_skip_what_is_missing_and_show_infinity() -> None:
    rows = [
        row("PAPR", "twist", "r_0", psnr=20.0, hole_rate=None, ssim=None),
        row("PAPR", "twist", "r_1", psnr=math.inf, hole_rate=0.2, ssim=None),
    ]
    (mean,) = state_means(rows)
    assert mean.views == 2
    assert mean.scores == {"psnr": math.inf, "hole_rate": pytest.approx(0.2), "ssim": None}


def test_files_keep_every_digit_and_survive_infinity(tmp_path: Path) -> None:
    rows = [
        row("PAPR", "canonical", foreground_psnr=math.inf, hole_rate=None, psnr=1 / 3),
        row("P-CORE", "canonical", foreground_psnr=12.5, hole_rate=math.nan, psnr=2.0),
    ]
    means = state_means(rows)
    perceptual = Perceptual(missing={"alex": "LPIPS: put alex.pth there"})
    record = summary_record(means, [], about={"run": "x"}, perceptual=perceptual)
    write_tables(tmp_path / "out", rows, record)
    with (tmp_path / "out" / "images.csv").open(newline="") as file:
        first, second = csv.DictReader(file)
    assert (first["foreground_psnr"], first["hole_rate"]) == ("inf", "")
    assert float(first["psnr"]) == 1 / 3
    assert second["hole_rate"] == ""
    text = (tmp_path / "out" / "summary.json").read_text()
    # Strict JSON: Python's own Infinity would be refused by every other reader.
    record = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert record["means"][0]["scores"]["foreground_psnr"] == "inf"
    assert record["notes"] == ["LPIPS: put alex.pth there"]
    assert "8-bit" in record["protocols"]["standard"]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["images.csv", "summary.json"]


def test_a_summary_comes_back(tmp_path: Path) -> None:
    tuned = rows_of("P-CORE", canonical=(29.7, 0.02), twist=(math.inf, 0.03), bend=(23.0, 0.05))
    means = state_means(BASE + tuned)
    found = gains(means, "PAPR")
    write_tables(tmp_path, BASE, summary_record(means, found, about={}))
    assert read_summary(tmp_path / "summary.json") == (means, found)


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"means": [{"state": 1}]}'])
def test_a_damaged_summary(tmp_path: Path, content: str) -> None:
    path = tmp_path / "summary.json"
    path.write_text(content)
    with pytest.raises(InputError, match="expected a summary that `pcore eval` wrote"):
        read_summary(path)


@pytest.mark.parametrize(
    ("value", "digits", "percent", "text"),
    [
        (12.345, 2, False, "12.35"),
        (-0.5, 1, False, "−0.5"),  # noqa: RUF001
        (-0.001, 2, False, "0.00"),
        (0.256, 1, True, "25.6 %"),
        (None, 2, False, "–"),  # noqa: RUF001
        (math.nan, 2, True, "–"),  # noqa: RUF001
        (math.inf, 2, False, "∞"),
    ],
)
def test_figures_for_people(value: Value, digits: int, percent: bool, text: str) -> None:
    assert shown(value, digits, percent=percent) == text


def test_every_column_is_on_the_page_with_its_unit() -> None:
    page = Path(__file__).resolve().parents[2] / "docs" / "concepts" / "metrics.md"
    table = page.read_text(encoding="utf-8").split("## Columns")[1].split("## ")[0]
    listed = set(re.findall(r"`(\w+)`", table))
    scores = ImageScores(psnr=1.0, ssim=1.0, foreground_psnr=1.0, foreground_ssim=1.0, lpips={})
    names = {*scores.row(), *GeometryScores.__dataclass_fields__, *HEALTH, *METRICS}
    names |= {*Cost.__dataclass_fields__, "milliseconds"}
    names |= {f"lpips_{trunk}" for trunk in get_args(TrunkName)}
    assert names <= listed
    rows = [row.split("|") for row in table.splitlines() if row.startswith("| `")]
    assert all(cells[2].strip() for cells in rows)
