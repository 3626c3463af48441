"""Tables in terminals of 80, 60 and 40 letters, and in pipes: no number is ever cut."""

from __future__ import annotations

import io
import re
from pathlib import Path

import pytest
from rich.cells import cell_len
from rich.console import Console
from toys import write_run

from pcore.cli import doctor
from pcore.cli.eval_results import show_results
from pcore.cli.info import InfoCommand
from pcore.cli.layout import Sheet, pair_lines, sheet_lines
from pcore.evaluation.protocol import STANDARD
from pcore.evaluation.summary import StateMean

WIDTHS = [None, 120, 80, 60, 40, 20]
METRICS = ("foreground_psnr", "psnr", "ssim", "lpips_alex", "lpips_squeeze", "lpips_vgg")
METRICS += ("hole_rate", "see_through_rate", "depth_error_relative", "spill_to_object")
HEALTH = ("strain_median", "strain_99", "strain_max", "self_intersection", "unseen")
STATES = ("canonical", "twist60", "a-state-with-a-long-name")
METHODS = ("no fine-tuning", "P-CORE", "aware + P-CORE + light")


def console(width: int | None) -> tuple[Console, io.StringIO]:
    """A terminal of so many letters; a pipe for None, which rich takes for 80 wide."""
    out = io.StringIO()
    terminal = width is not None
    return Console(file=out, width=width, force_terminal=terminal, no_color=True), out


def means() -> list[StateMean]:
    """Scores that are all different."""
    found: list[StateMean] = []
    for number, (state, method) in enumerate((s, m) for s in STATES for m in METHODS):
        scores = {name: 10 + number + k / 100 for k, name in enumerate((*METRICS, *HEALTH))}
        found.append(
            StateMean(
                method=method,
                state=state,
                kind="analytic",
                protocol=STANDARD.name,
                views=3,
                scores=scores,
            )
        )
    return found


def numbers(text: str) -> list[str]:
    return sorted(re.findall(r"\d+\.\d+", text))


@pytest.mark.parametrize("width", WIDTHS)
def test_results_are_whole_at_every_width(width: int | None) -> None:
    shown, out = console(width)
    show_results(shown, means(), [], perceptual=None)
    text = re.sub(r"\x1b\[[0-9;]*m", "", out.getvalue())
    piped, whole = console(None)
    show_results(piped, means(), [], perceptual=None)
    assert numbers(text) == numbers(whole.getvalue())
    for digits, metric in enumerate(METRICS[:6]):
        for one in means():
            assert f"{one.scores[metric]:.{3 if digits > 1 else 2}f}" in text
    assert "…" not in text
    assert "..." not in text
    for name in (*STATES, *METHODS):
        assert name in text
    # The sentence below a table is wrapped by the terminal.
    figures = [line for line in text.splitlines() if numbers(line) and "sigma" not in line]
    if width is not None and width >= 40:
        assert max(map(cell_len, figures)) <= width
    if width is None:
        assert len(figures) == 18, "one line for each row of both tables"


@pytest.mark.parametrize("width", WIDTHS)
def test_every_figure_stands_with_its_row_and_heading(width: int | None) -> None:
    rows = tuple(((f"s{k // 2}", f"m{k}"), (f"{k}.25", f"{k}.5", f"{k}.75")) for k in range(4))
    columns = ("fg\nPSNR", "\nSSIM", "see-\nthrough")
    sheet = Sheet(title="t", keys=("state", "method"), columns=columns, rows=rows)
    lines = sheet_lines(sheet, width)
    assert lines[0] == "t"
    if width is None:
        assert lines[1].split() == ["fg", "see-"]
        assert lines[2].split() == ["state", "method", "PSNR", "SSIM", "through"]
        assert lines[3].split() == ["s0", "m0", "0.25", "0.5", "0.75"]
        assert lines[4].split() == ["m1", "1.25", "1.5", "1.75"]
    if width == 20:
        assert lines[1:7] == ["", "s0", " m0", "  fg PSNR      0.25", "  SSIM          0.5",
                              "  see-through  0.75"]  # fmt: skip


def test_fewer_columns_before_blocks() -> None:
    columns = tuple(f"c{k}" for k in range(6))
    rows = ((("canonical",), tuple("123.45" for _ in columns)),)
    lines = sheet_lines(Sheet(title="t", keys=("state",), columns=columns, rows=rows), 42)
    assert [line.split() for line in lines] == [
        ["t"],
        ["state", *columns[:4]],
        ["canonical", *4 * ["123.45"]],
        [],
        ["state", *columns[4:]],
        ["canonical", *2 * ["123.45"]],
    ]


@pytest.mark.parametrize("width", WIDTHS)
def test_names_and_values(width: int | None) -> None:
    rows = [
        ("extent", "(-0.794, -0.787, -0.797) to (0.795, 0.782, 0.743), world units"),
        ("papr.octaves.direction", "2"),
        ("model", "/a/" + "b" * 90 + "/model.safetensors"),
    ]
    lines = pair_lines(rows, width)
    assert numbers(" ".join(lines)) == numbers(rows[0][1])
    assert any("/a/" + "b" * 90 + "/model.safetensors" in line for line in lines)
    assert max(cell_len(line) for line in lines if "bbb" not in line) <= max(width or 999, 22)
    if width is None:
        assert len(lines) == 3


@pytest.mark.parametrize("width", WIDTHS)
def test_info_fits_on_a_screen(tmp_path: Path, monkeypatch, capsys, width: int | None) -> None:
    monkeypatch.chdir(tmp_path)
    write_run(Path("run"), scene="ball")
    shown, out = console(width)
    monkeypatch.setattr("pcore.cli.info.Console", lambda: shown)
    InfoCommand(run_or_file=Path("run")).run()
    lines = out.getvalue().splitlines()
    assert len(lines) <= 24
    assert "listed with --settings" in " ".join(out.getvalue().split())
    InfoCommand(run_or_file=Path("run"), settings=True).run()
    assert "papr.octaves.direction" in out.getvalue()
    if width is not None and width >= 40:
        assert max(map(cell_len, out.getvalue().splitlines())) <= width


def test_doctor_fits_on_a_screen(monkeypatch, tmp_path: Path, capsys) -> None:
    for name in ("PCORE_LPIPS_DIR", "XDG_CACHE_HOME", "TORCH_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    doctor.DoctorCommand().run()
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 24
    assert sum("LPIPS" in line or "weights" in line for line in lines) == 2
    rest = [line for line in lines if "disk" not in line]
    assert max(map(cell_len, rest)) <= 100
    doctor.DoctorCommand(weights=True).run()
    text = capsys.readouterr().out
    for trunk in ("alex", "squeeze", "vgg"):
        assert f"LPIPS {trunk}" in text
        assert f"lin_{trunk}.pth" in text
    assert "torch  " not in text
