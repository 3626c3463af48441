"""Fixtures shared by all tests."""

import os
from pathlib import Path

import pytest
import torch

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real test data; tests that need it skip when it is absent."""
    path = Path(os.environ.get("PCORE_SHARED_DATA", REPOSITORY.parent / "shared" / "data"))
    if not (path / "oracle").is_dir():
        pytest.skip("shared test data is absent (set PCORE_SHARED_DATA to the folder with oracle/)")
    return path


@pytest.fixture(autouse=True)
def _seed() -> None:
    torch.manual_seed(0)
    # Commands switch it on for their process; here many tests share one.
    torch.set_flush_denormal(False)
