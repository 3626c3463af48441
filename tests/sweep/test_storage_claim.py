"""One sweep at a time writes to a storage."""

from __future__ import annotations

import time
from typing import Any

import pytest

from pcore.errors import InputError
from pcore.sweep import storage_claim
from pcore.sweep.storage_claim import CLAIM_FILE, claimed
from pcore.sweep.sweep_storage import opened


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storage_claim, "BEAT", 0.5)
    monkeypatch.setattr(storage_claim, "_MEETING", 0.05)


def claim_in(url: str) -> bool:
    files, root = opened(url)
    return bool(files.exists(f"{root}/{CLAIM_FILE}"))


def test_a_second_sweep_is_refused_while_the_first_one_lives(url: str) -> None:
    with claimed(url):
        said = "expected no other sweep that writes there, got one of process"
        with pytest.raises(InputError, match=said), claimed(url):
            raise AssertionError("both have it")
        assert claim_in(url)
    assert not claim_in(url)
    with claimed(url):
        assert claim_in(url)


@pytest.mark.parametrize("left", [b'{"host": "x", "process": 1, "sweep": "a", "beat": 7}', b"{"])
def test_what_a_killed_sweep_has_left_holds_nobody_up_for_long(url: str, left: bytes) -> None:
    files, root = opened(url)
    files.pipe_file(f"{root}/{CLAIM_FILE}", left)
    begun = time.monotonic()
    with claimed(url):
        assert time.monotonic() - begun < 5
    assert not claim_in(url)


def test_a_slow_one_that_overwrites_a_sign_lets_the_first_one_be(
    url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It saw no sign, and its own comes when the other one has passed its meeting."""
    read, write, early = storage_claim._read, storage_claim._write, [None]

    def late(url: str, sign: dict[str, Any], beat: int) -> None:
        if beat == 0:
            time.sleep(0.1)
        write(url, sign, beat)

    with claimed(url):
        monkeypatch.setattr(storage_claim, "_read", lambda url: early.pop() if early else read(url))
        monkeypatch.setattr(storage_claim, "_write", late)
        with pytest.raises(InputError, match="got one of process"), claimed(url):
            raise AssertionError("both have it")


def test_half_a_sign_is_one_that_is_being_written(
    url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    files, root = opened(url)

    def begin(seconds: float) -> None:
        files.pipe_file(f"{root}/{CLAIM_FILE}", b"{")

    monkeypatch.setattr(storage_claim.time, "sleep", begin)
    said = "got one whose sign is just being written; wait for its end"
    with pytest.raises(InputError, match=said), claimed(url):
        raise AssertionError("both have it")


def test_two_that_begin_at_once_see_each_other(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    files, root = opened(url)

    def meets(seconds: float) -> None:
        files.pipe_file(f"{root}/{CLAIM_FILE}", b'{"host": "other", "process": 5, "beat": 0}')

    monkeypatch.setattr(storage_claim.time, "sleep", meets)
    with pytest.raises(InputError, match="got one of process 5 on other"), claimed(url):
        raise AssertionError("both have it")
