"""Fixtures shared by all tests."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from tests.forked import Forked

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


@pytest.fixture(scope="session")
def forked() -> Iterator[Forked]:
    """Starts programs in processes of their own, which need not import torch first."""
    if not hasattr(os, "fork"):
        pytest.skip("this system forks no processes")
    one = Forked()
    yield one
    one.end()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium with software WebGL; tests that need it skip where it is absent.

    It ends with its module: its event loop stands in the way of tests that have their own.
    """
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no chromium on this machine")
    flags = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=program, args=flags)
        yield started
        started.close()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest test begins first, lest one process waits for it in the end."""
    items.sort(key=lambda item: item.path.name != "test_story.py")
