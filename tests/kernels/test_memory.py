"""Keeping freed memory: a request to the C library that changes no result."""

from __future__ import annotations

import ctypes

import pytest
import torch

from pcore.kernels.memory import keep_freed_memory


def test_asking_twice_gives_the_same_answer() -> None:
    first = keep_freed_memory()
    assert isinstance(first, bool)
    assert keep_freed_memory() is first
    assert float(torch.ones(3_000_000).sum()) == 3_000_000


def test_systems_without_mallopt_say_no(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda name: object())
    assert keep_freed_memory() is False


def test_a_setting_that_is_refused_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    class Library:
        @staticmethod
        def mallopt(option: int, value: int) -> int:
            return int(option != -1)

    monkeypatch.setattr(ctypes, "CDLL", lambda name: Library())
    assert keep_freed_memory() is False
