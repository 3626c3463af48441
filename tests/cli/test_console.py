"""Progress in a terminal and in a log file; errors of the machine."""

import errno
import io
import os
from pathlib import Path

import pytest
from rich.console import Console

from pcore.cli.console import ProgressDisplay, clock, guarded, say
from pcore.cli.output import check_place
from pcore.errors import InputError
from pcore.training.events import (
    BudgetReport,
    PopulationReport,
    StepReport,
    Stopped,
    ValidationReport,
)


def report(step: int) -> StepReport:
    return StepReport(
        stage="pretrain",
        step=step,
        steps=10,
        loss=0.01234,
        psnr=21.55,
        points=5432,
        seconds_left=75.0,
    )


def test_lines_stay_whole_and_have_no_markup() -> None:
    out = io.StringIO()
    lines = ["photos/[red]house[/red] :smile: 1.5", 70 * "long "]
    say(Console(file=out, width=40, force_terminal=True, color_system=None), *lines)
    assert out.getvalue().split("\n")[:2] == lines


def test_without_a_terminal_there_is_a_line_now_and_then() -> None:
    out, now = io.StringIO(), [0.0]
    display = ProgressDisplay(
        Console(file=out, width=60), seconds_between_lines=10, now=lambda: now[0]
    )
    with display:
        for step, seconds in ((1, 0.0), (2, 5.0), (3, 11.0), (4, 12.0), (10, 13.0)):
            now[0] = seconds
            display(report(step))
    lines = out.getvalue().splitlines()
    assert [line.split()[1] for line in lines] == ["1/10", "3/10", "10/10"]
    expected = "pretrain 1/10  loss 0.01234  PSNR 21.6 dB  5,432 points  1:15 left"
    assert lines[0] == expected


def test_validation_and_the_end_are_said_in_words() -> None:
    out = io.StringIO()
    with ProgressDisplay(Console(file=out)) as display:
        display(ValidationReport(stage="finetune", step=5, psnr=22.345, views=4, best=True))
        display(ValidationReport(stage="finetune", step=6, psnr=22.0, views=4, best=False))
        display(PopulationReport(stage="finetune", step=6, pruned=1, grown=2, points=3))
        display(Stopped(stage="finetune", step=7, reason="interrupted", message="go on [so]"))
    assert out.getvalue().splitlines() == [
        "finetune 5: held-out views 22.34 dB (mean of 4), the best so far",
        "finetune 6: held-out views 22.00 dB (mean of 4)",
        "finetune interrupted at step 7: go on [so]",
    ]


@pytest.mark.parametrize(
    ("share", "psnr", "expected"),
    [
        (0.7, 29.51, "took 0.70 of the change: held-out views -0.49 dB (budget 0.5, all of it "),
        (1.0, 28.77, "took all of the change: held-out views -1.23 dB (budget 0.5)"),
    ],
)
def test_the_trade_is_told(share: float, psnr: float, expected: str) -> None:
    out = io.StringIO()
    told = BudgetReport(
        stage="finetune",
        step=9,
        share=share,
        before=30.0,
        after=28.77,
        psnr=psnr,
        largest_loss=0.5,
    )
    with ProgressDisplay(Console(file=out)) as display:
        display(told)
    line = out.getvalue().strip()
    assert line.startswith(f"finetune 9: {expected}")
    assert line.endswith("all of it -1.23 dB)") is (share < 1)


def test_in_a_terminal_there_is_a_bar() -> None:
    out = io.StringIO()
    console = Console(file=out, force_terminal=True, width=120)
    with ProgressDisplay(console) as display:
        display(report(3))
        display(report(7))
    shown = out.getvalue()
    assert "7/10" in shown
    assert "PSNR 21.6 dB" in shown
    assert "1:15 left" in shown
    assert "━" in shown


@pytest.mark.parametrize(
    ("seconds", "shown"), [(0.2, "0:00"), (75, "1:15"), (3723, "1:02:03"), (-5, "0:00")]
)
def test_clock(seconds: float, shown: str) -> None:
    assert clock(seconds) == shown


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EFBIG, errno.EEXIST])
def test_a_full_disk_is_one_message(capsys: pytest.CaptureFixture[str], code: int) -> None:
    def fill() -> None:
        raise OSError(code, os.strerror(code), "RUN/picture.png")

    assert guarded(fill) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"Error: RUN/picture.png: {os.strerror(code)}; ")
    assert "undamaged" in said


@pytest.mark.parametrize("place", ["FILE", "FILE/x", "FILE/x/y", "/proc/x", "/proc/x/y"])
def test_a_place_that_cannot_be_made_is_said_before_any_work(tmp_path: Path, place: str) -> None:
    (tmp_path / "FILE").touch()
    with pytest.raises(InputError, match=r"is a file: expected|nothing can be written into /"):
        check_place(tmp_path / place)
    check_place(tmp_path / "new" / "folder")
    assert [one.name for one in tmp_path.iterdir()] == ["FILE"]


def test_our_own_bugs_keep_their_traceback() -> None:
    def bug() -> None:
        raise FileNotFoundError(errno.ENOENT, "x")

    with pytest.raises(FileNotFoundError):
        guarded(bug)


def test_an_interrupt_passes_on_how_to_go_on(capsys: pytest.CaptureFixture[str]) -> None:
    def stop() -> None:
        raise KeyboardInterrupt("step 5 is saved; go on with `pcore train S -o R --resume`")

    assert guarded(stop) == 130
    assert "go on with `pcore train S -o R --resume`" in capsys.readouterr().err


def test_of_several_processes_one_tells_of_the_interruption(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop() -> None:
        raise KeyboardInterrupt("step 7 is saved")

    monkeypatch.setenv("WORLD_SIZE", "2")
    for rank, told in (("0", "Interrupted: step 7 is saved\n"), ("1", "")):
        monkeypatch.setenv("RANK", rank)
        assert guarded(stop) == 130
        assert capsys.readouterr().err == told
