"""The run folder: nothing is overwritten, failures are found early and lose nothing."""

import errno
import json
import os
import shutil
import signal
import sys
from pathlib import Path

import pytest
import torch
from tests.forked import Forked

from pcore.errors import CheckpointError, InputError, TrainingError
from pcore.files import run_folder as output
from pcore.files.lock import held
from pcore.files.run_folder import RunFolder
from pcore.files.run_place import bytes_needed
from pcore.files.run_record import RunRecord
from pcore.files.training_state import TrainingState
from pcore.training.events import silent
from pcore.training.in_folder import RunOptions, train_in_folder

CONFIG = {"steps": 100, "papr": {"neighbours": 8, "size": (1, 2)}}


def create(
    path: Path, *, resume: bool = False, config: dict | None = None, **rest: int
) -> RunFolder:
    return RunFolder.create(
        path, stage="pretrain", scene="lego", config=config or CONFIG, resume=resume, **rest
    )


def state(step: int) -> TrainingState:
    return TrainingState(
        stage="pretrain",
        step=step,
        papr={"w": torch.ones(3)},
        cloud={},
        optimisers={},
        generators={},
    )


def files(folder: Path) -> dict[str, bytes]:
    return {item.name: item.read_bytes() for item in folder.iterdir() if item.is_file()}


def test_a_new_run_says_what_it_is(tmp_path: Path) -> None:
    path = tmp_path / "a" / "run"
    with create(path) as run:
        manifest = json.loads((path / "run.json").read_text())
        assert manifest["format"] == "pcore-run"
        assert manifest["config"] == {"steps": 100, "papr": {"neighbours": 8, "size": [1, 2]}}
        assert (run.stage, run.scene) == ("pretrain", "lego")
        assert run.load_state() is None
        run.save_state(state(4))
        run.update(psnr=20.5)
    again = RunFolder.open(str(path))
    assert again.notes == {"status": "running", "psnr": 20.5}
    assert again.saved_step() == 4
    assert again.config["steps"] == 100
    assert (again.model.name, again.log.name) == ("model.safetensors", "log.jsonl")
    assert (again.tensorboard, again.renders) == (path / "tensorboard", path / "renders")


def test_another_run_is_never_overwritten(tmp_path: Path) -> None:
    with create(tmp_path / "run") as run:
        run.save_state(state(4))
    before = files(tmp_path / "run")
    with pytest.raises(InputError) as caught:
        create(tmp_path / "run")
    assert "holds a run already" in str(caught.value)
    assert "--resume" in str(caught.value)
    assert "-o" in str(caught.value)
    assert files(tmp_path / "run") == before


def test_foreign_files_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("dear")
    with pytest.raises(InputError, match=r"holds other files \(thesis\.tex\).*-o"):
        create(tmp_path)
    assert files(tmp_path) == {"thesis.tex": b"dear"}
    with pytest.raises(InputError, match="holds other files"):
        create(tmp_path, resume=True)
    with pytest.raises(InputError, match="is a file"):
        create(tmp_path / "thesis.tex")


def test_an_empty_folder_and_leftovers_of_a_kill_are_taken(tmp_path: Path) -> None:
    (tmp_path / ".lock").write_text("1\n")
    (tmp_path / ".run.json.17.partial").write_text("{")
    with create(tmp_path):
        assert sorted(files(tmp_path)) == [".lock", "run.json"]


def test_resuming_continues_the_same_run(tmp_path: Path) -> None:
    with create(tmp_path) as run:
        run.save_state(state(4))
        run.update(psnr=20.5)
    with create(tmp_path, resume=True) as run:
        found = run.load_state()
        assert found is not None
        assert found.step == 4
        assert run.notes["psnr"] == 20.5


def test_resuming_with_other_settings_names_the_keys(tmp_path: Path) -> None:
    with create(tmp_path) as run:
        run.save_state(state(4))
    changed = {"steps": 200, "papr": {"neighbours": 8, "size": [1, 3]}}
    with pytest.raises(InputError) as caught:
        create(tmp_path, resume=True, config=changed)
    message = str(caught.value)
    assert "steps: 100 -> 200" in message
    assert "papr.size: [1, 2] -> [1, 3]" in message
    assert "neighbours" not in message


def test_settings_that_came_later_and_are_not_used_do_not_keep_a_run_from_going_on(
    tmp_path: Path,
) -> None:
    with create(tmp_path, config={"steps": 100}) as run:
        run.save_state(state(4))
    create(tmp_path, resume=True, config={"steps": 100, "skinning": None}).close()
    with pytest.raises(InputError, match=r"skinning: \(absent\) -> 3"):
        create(tmp_path, resume=True, config={"steps": 100, "skinning": 3})


@pytest.mark.parametrize("resume", [False, True])
def test_a_run_that_saved_nothing_begins_anew_with_any_settings(
    tmp_path: Path, resume: bool
) -> None:
    create(tmp_path).close()
    (tmp_path / "log.jsonl").write_text("of the other\n")
    with create(tmp_path, resume=resume, config={"steps": 7}) as run:
        assert run.config == {"steps": 7}
        assert not run.log.exists()
        run.save_state(state(4))
    with pytest.raises(InputError, match="holds a run already"):
        create(tmp_path, config={"steps": 8})


def test_a_lock_is_held_while_its_process_lives(tmp_path: Path) -> None:
    assert not held(tmp_path)
    with create(tmp_path):
        assert held(tmp_path)
        assert held(tmp_path)
    assert not held(tmp_path)
    with create(tmp_path):  # Looking takes nothing away.
        pass


def test_nothing_to_resume(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing to resume at"):
        create(tmp_path / "absent", resume=True)
    assert not (tmp_path / "absent").exists()


def test_too_little_space_is_found_before_anything_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        output.shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(9, 8, 10**6)
    )
    with pytest.raises(TrainingError, match="expected 17 MB free, got 1 MB"):
        create(tmp_path / "run", needed=bytes_needed(20_000))
    assert not (tmp_path / "run").exists()


def test_space_grows_with_the_model() -> None:
    assert bytes_needed(2_000_000) - bytes_needed(1_000_000) == 48_000_000


def test_an_unwritable_folder_is_found_before_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_only(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(Path, "mkdir", read_only)
    with pytest.raises(TrainingError, match=r"cannot write into .*Read-only file system.*-o"):
        create(tmp_path / "run")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(TrainingError, match=r"cannot write into .*Permission denied"):
        create(tmp_path / "run")


def test_a_disk_that_fills_up_later_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with create(tmp_path) as run:
        run.save_state(state(4))
        before = files(tmp_path)
        with monkeypatch.context() as patch:
            patch.setattr(Path, "replace", full)
            with pytest.raises(TrainingError) as caught:
                run.save_state(state(5))
        message = str(caught.value)
        assert f"cannot write {run.state}: No space left on device" in message
        assert f"undamaged in {tmp_path}: state.pt of step 4, run.json" in message
        assert "--resume" in message
        assert files(tmp_path) == before
        run.save_state(state(5))
        assert run.saved_step() == 5


def test_a_failure_before_the_first_save_says_that_nothing_is_there(tmp_path: Path) -> None:
    with (
        pytest.raises(TrainingError, match="nothing was saved in"),
        output.write_guard(tmp_path / "state.pt"),
    ):
        raise OSError(errno.EIO, os.strerror(errno.EIO))


def test_two_runs_in_one_folder(tmp_path: Path) -> None:
    with (
        create(tmp_path),
        pytest.raises(InputError, match=rf"another process \(id {os.getpid()}\)"),
    ):
        create(tmp_path, resume=True)
    with create(tmp_path, resume=True) as run:
        assert run.notes["status"] == "running"


HOLDER = """
import sys, time
from pathlib import Path
from pcore.files.run_folder import RunFolder
run = RunFolder.create(Path(sys.argv[1]), stage="pretrain", scene="lego", config={"steps": 1})
print("locked", flush=True)
time.sleep(60)
"""


def test_a_killed_process_does_not_keep_the_lock(tmp_path: Path, forked: Forked) -> None:
    path, config = tmp_path / "run", {"steps": 1}
    process = forked.start(HOLDER, str(path), said=tmp_path / "said")
    process.says("locked\n")
    with pytest.raises(InputError, match=f"id {process.pid}.*is training into"):
        create(path, resume=True, config=config)
    assert process.end() == -signal.SIGKILL
    with create(path, resume=True, config=config) as run:
        assert run.load_state() is None


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no run at"),
        ("{", "expected JSON"),
        ("[]", "does not describe a run of pcore"),
        ('{"format": "other"}', "got 'other'"),
        ('{"format": "pcore-run", "version": 2}', "has version 2 of the run format"),
        ('{"format": "pcore-run", "version": 1}', "missing key config, notes, scene, stage"),
    ],
)
def test_damaged_manifests(tmp_path: Path, content: str | None, message: str) -> None:
    if content is not None:
        (tmp_path / "run.json").write_text(content)
    with pytest.raises(CheckpointError, match=message):
        RunFolder.open(tmp_path)


FILLER = """
import resource, sys, torch
from pathlib import Path
from pcore.errors import TrainingError
from pcore.files.run_folder import RunFolder
from pcore.files.training_state import TrainingState
def state(step):
    return TrainingState(stage="pretrain", step=step, papr={"w": torch.ones(1000 * step ** 3)},
        cloud={}, optimisers={}, generators={})
with RunFolder.create(Path(sys.argv[1]), stage="pretrain", scene="lego", config={}) as run:
    run.save_state(state(1))
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
    try:
        run.save_state(state(10))
    except TrainingError as error:
        print(error)
    print(run.saved_step())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="limits of file sizes are of POSIX")
def test_a_write_that_the_system_stops_halfway_loses_nothing(
    tmp_path: Path, forked: Forked
) -> None:
    done = forked.start(FILLER, str(tmp_path / "run"), said=tmp_path / "said")
    assert done.wait() == 0, done.said.read_text()
    message, step = done.said.read_text().splitlines()[-2:]
    assert "File too large; already saved and undamaged" in message
    assert "state.pt of step 1" in message
    assert step == "1"
    assert sorted(files(tmp_path / "run")) == [".lock", "run.json", "state.pt"]


def test_seconds_are_those_of_both_trainings(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    with create(first) as run:
        run.update(processor_seconds=40.5)
    with create(second, config={**CONFIG, "base": "../first"}) as run:
        assert RunRecord.read(second).seconds is None
        run.update(processor_seconds=2)
    assert RunRecord.read(first).seconds == 40.5
    assert RunRecord.read(second).seconds == 42.5
    shutil.rmtree(first)
    assert RunRecord.read(second).seconds is None


def test_what_a_killed_training_took_is_not_known(tmp_path: Path) -> None:
    path = tmp_path / "run"
    record = RunRecord(path=path, stage="pretrain", config=CONFIG)

    def train(run: RunFolder, *, until: int) -> None:
        run.save_state(state(until))
        if until == 4:
            raise KeyboardInterrupt

    def spent() -> float | None:
        return RunFolder.open(path).notes["processor_seconds"]

    with pytest.raises(KeyboardInterrupt):
        train_in_folder(
            record, lambda run, tell: train(run, until=4), silent, RunOptions(), scene="lego"
        )
    first = spent()
    assert first is not None
    again = RunOptions(resume=True)
    train_in_folder(record, lambda run, tell: train(run, until=5), silent, again, scene="lego")
    both = spent()
    assert both is not None
    assert both >= first
    # Every process says what it was, and where it began.
    began = RunFolder.open(path).notes["made_by"]
    assert [one["step"] for one in began] == [0, 4]
    assert {one["torch"] for one in began} == {torch.__version__}
    with RunFolder.create(path, stage="pretrain", scene="lego", config=CONFIG, resume=True) as run:
        run.update(processor_seconds=None)
    train_in_folder(record, lambda run, tell: train(run, until=6), silent, again, scene="lego")
    assert spent() is None
