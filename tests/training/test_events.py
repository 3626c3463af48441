"""Listeners: what loops say is written down once, and only once."""

import json
import sys
from pathlib import Path

import pytest

from pcore.errors import DependencyError, TrainingError
from pcore.training import events
from pcore.training.events import (
    BudgetReport,
    Event,
    JsonLinesLog,
    PopulationReport,
    Saved,
    StepReport,
    Stopped,
    TensorBoardLog,
    ValidationReport,
    fan_out,
    silent,
)

TRADE = BudgetReport(
    stage="pretrain", step=1, share=0.5, before=20.0, after=19.0, psnr=19.6, largest_loss=0.5
)


def report(step: int, stage: str = "pretrain", loss: float = 0.5) -> StepReport:
    return StepReport(
        stage=stage,
        step=step,
        steps=10,
        loss=loss,
        losses={"rgb": 0.4},
        psnr=20.0,
        points=7,
        rates={"points": 0.1},
    )


def lines(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_every_event_is_one_line_of_json(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    said: list[Event] = [
        report(1),
        ValidationReport(stage="pretrain", step=1, psnr=19.5, views=3, best=True),
        PopulationReport(stage="pretrain", step=1, pruned=2, grown=3, points=8),
        TRADE,
        Saved(stage="pretrain", step=1, path="RUN/state.pt"),
        Stopped(stage="pretrain", step=1, reason="finished"),
    ]
    with JsonLinesLog(path) as log:
        for event in said:
            log(event)
        # On the disk at once: a killed run keeps its log.
        assert len(lines(path)) == 6
    written = lines(path)
    assert [line["event"] for line in written] == [
        "step",
        "validation",
        "population",
        "budget",
        "saved",
        "stopped",
    ]
    assert written[0]["losses"] == {"rgb": 0.4}
    assert written[1]["best"] is True
    assert written[2]["points"] == 8
    assert (written[3]["share"], written[3]["psnr"]) == (0.5, 19.6)


def test_numbers_json_does_not_know_are_null(tmp_path: Path) -> None:
    with JsonLinesLog(tmp_path / "log.jsonl") as log:
        log(report(1, loss=float("nan")))
    assert lines(tmp_path / "log.jsonl")[0]["loss"] is None


def test_resuming_cuts_later_lines_of_the_stage_only(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    with JsonLinesLog(path) as log:
        for event in (
            report(9),
            report(1, "finetune"),
            report(2, "finetune"),
            report(3, "finetune"),
        ):
            log(event)
    with JsonLinesLog(path, resumed=("finetune", 1)) as log:
        log(report(2, "finetune"))
    assert [(line["stage"], line["step"]) for line in lines(path)] == [
        ("pretrain", 9),
        ("finetune", 1),
        ("finetune", 2),
    ]


@pytest.mark.parametrize("torn", [b'{"event": "st', b"\x00\x00\x00\n", b"7\n"])
def test_a_line_torn_by_a_kill_is_dropped(tmp_path: Path, torn: bytes) -> None:
    path = tmp_path / "log.jsonl"
    with JsonLinesLog(path) as log:
        log(report(1))
    with path.open("ab") as file:
        file.write(torn)
    with JsonLinesLog(path, resumed=("pretrain", 5)) as log:
        log(report(2))
    assert [line["step"] for line in lines(path)] == [1, 2]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs the device that is always full")
def test_a_full_disk_is_a_clear_error(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    path.symlink_to("/dev/full")
    log = JsonLinesLog(path)
    with pytest.raises(TrainingError, match=r"cannot write .*log\.jsonl: No space left on device"):
        log(report(1))
    with pytest.raises(TrainingError, match="No space left"):
        log.close()


def test_an_unwritable_log_is_found_when_it_is_opened(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=r"cannot write .*No such file or directory"):
        JsonLinesLog(tmp_path / "absent" / "log.jsonl")


def test_fan_out_tells_all_in_order() -> None:
    heard: list[tuple[str, int]] = []
    tell = fan_out(
        lambda event: heard.append(("a", event.step)),
        silent,
        lambda event: heard.append(("b", event.step)),
    )
    tell(report(4))
    assert heard == [("a", 4), ("b", 4)]


def test_without_tensorboard_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard.writer", None)
    with pytest.raises(DependencyError, match=r"pip install 'pcore-edit\[log\]'"):
        TensorBoardLog(tmp_path)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_tensorboard_gets_the_curves(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    with TensorBoardLog(tmp_path / "tb") as log:
        log(report(1))
        log(report(2, loss=0.25))
        log(ValidationReport(stage="pretrain", step=2, psnr=19.5, views=3, best=True))
        log(PopulationReport(stage="pretrain", step=2, pruned=2, grown=3, points=8))
        log(Stopped(stage="pretrain", step=2, reason="finished"))
    with TensorBoardLog(tmp_path / "tb", resumed=("pretrain", 1)) as log:
        log(report(2, loss=0.125))
    found = EventAccumulator(str(tmp_path / "tb")).Reload()
    assert [(s.step, s.value) for s in found.Scalars("pretrain/loss")] == [(1, 0.5), (2, 0.125)]
    assert {"pretrain/loss/rgb", "pretrain/rate/points", "pretrain/psnr", "pretrain/points"} <= set(
        found.Tags()["scalars"]
    )


def test_curves_of_an_event() -> None:
    event = ValidationReport(
        stage="s", step=1, psnr=19.5, views=3, scores={"lpips": 0.1}, best=False
    )
    assert events._scalars(event) == {"validation/psnr": 19.5, "validation/lpips": 0.1}
