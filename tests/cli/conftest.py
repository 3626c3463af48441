"""Fixtures shared by the tests of the commands."""

import pytest


@pytest.fixture(autouse=True)
def _no_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    # Whose machine has LPIPS weights must see the same: pictures here are too small for them.
    monkeypatch.delenv("PCORE_LPIPS_DIR", raising=False)
