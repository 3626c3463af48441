"""Ports and runs."""

import shutil
import socket
from contextlib import closing
from importlib.resources import as_file, files
from pathlib import Path

import pytest


@pytest.fixture
def free_port() -> int:
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def run(tmp_path: Path) -> Path:
    with as_file(files("pcore.studio").joinpath("demo_run")) as source:
        return Path(shutil.copytree(source, tmp_path / "run"))
