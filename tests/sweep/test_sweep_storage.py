"""Trials whose folder is mirrored: what was sent is where another machine begins."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from pcore.errors import InputError
from pcore.sweep import sweep_storage
from pcore.sweep.sweep_storage import check_storage, fetch, mirrored, opened
from pcore.sweep.sweep_trial import Trial, attempt


def trial_in(folder: Path, url: str) -> Trial:
    return Trial(
        scene="a",
        setting="b",
        seed=0,
        scene_folder=folder / "scene",
        folder=folder / "trial",
        verbs={"train": {}},
        threads=1,
        device="cpu",
        storage=url,
    )


def files(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): path.read_text()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_a_trial_goes_on_where_another_machine_was_killed(url: str, tmp_path: Path) -> None:
    one, two = trial_in(tmp_path / "one", url), trial_in(tmp_path / "two", url)

    def killed(trial: Trial) -> None:
        state = trial.folder / "run" / "state.pt"
        state.parent.mkdir()
        state.write_text("step 100")
        (trial.folder / "run" / ".lock").write_text("")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        attempt(one, killed)
    (two.folder / "run").mkdir(parents=True)
    (two.folder / "run" / "state.pt").write_text("step 50, of an attempt before")

    def goes_on(trial: Trial) -> None:
        state = trial.folder / "run" / "state.pt"
        assert state.read_text() == "step 100"
        state.unlink()
        (trial.folder / "run" / "model").write_text("done")

    assert attempt(two, goes_on).failed is None
    fetch(url, tmp_path / "three")
    found = files(tmp_path / "three")
    assert found == files(two.folder)
    assert {*found} == {"inputs.json", "output.txt", "run/model", "trial.json"}
    fetch(url, tmp_path / "four", records=True)
    assert {*files(tmp_path / "four")} == {"inputs.json", "output.txt", "trial.json"}


def test_what_was_made_without_the_storage_gets_there_as_well(url: str, tmp_path: Path) -> None:
    """As where a sweep was begun without one, or was killed before anything was sent."""
    trial = trial_in(tmp_path / "one", url)
    model = trial.folder / "run" / "model"
    model.parent.mkdir(parents=True)
    model.write_text("trained already")
    assert attempt(trial, lambda _: None).failed is None
    assert fetch(url, tmp_path / "two")
    assert files(tmp_path / "two")["run/model"] == "trained already"


def test_what_changes_is_sent_meanwhile(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep_storage, "SEND_EVERY", 0.02)
    folder = tmp_path / "trial"
    with mirrored(folder, url):
        folder.mkdir()
        (folder / "state.pt").write_text("step 1")
        end = time.monotonic() + 120
        seen = tmp_path / "seen"
        while not (seen / "state.pt").exists() and time.monotonic() < end:
            fetch(url, seen)
        assert (seen / "state.pt").read_text() == "step 1"


def test_a_storage_that_fails_is_a_trial_that_failed(tmp_path: Path) -> None:
    trial = trial_in(tmp_path, f"file://{tmp_path}/storage")
    (tmp_path / "storage").write_text("a file")

    def run(trial: Trial) -> None:
        """Nothing."""

    failed = attempt(trial, run).failed
    assert failed is not None
    assert failed.startswith("storage file://")


def test_a_bucket_that_is_not_there_is_not_made(s3_bucket: str) -> None:
    """A name that is mistyped would else be a new place of the lab's account."""
    with pytest.raises(InputError, match="there is no bucket 'labb'"):
        check_storage(f"{s3_bucket}b/sweep")
    assert not opened(s3_bucket)[0].exists("labb")
