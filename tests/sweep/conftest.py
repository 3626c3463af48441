"""Storages of sweeps: in memory, on disk, and a server that speaks S3 where its packages are."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path

import pytest

from pcore.sweep.sweep_storage import check_storage

_NO_S3 = "no server of buckets: pip install s3fs 'moto[server]' (45 packages, not in `dev`)"


@pytest.fixture(scope="session")
def s3_server() -> Generator[str]:
    """Address of a server of buckets that lives as long as the tests."""
    pytest.importorskip("s3fs", reason=_NO_S3)
    server = pytest.importorskip("moto.server", reason=_NO_S3)
    one = server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    one.start()
    host, port = one.get_host_and_port()
    yield f"http://{host}:{port}"
    one.stop()


@pytest.fixture
def s3_bucket(s3_server: str, monkeypatch: pytest.MonkeyPatch) -> str:
    """URL of an empty bucket."""
    s3fs = pytest.importorskip("s3fs", reason=_NO_S3)
    settings = {"ENDPOINT_URL": s3_server, "ACCESS_KEY_ID": "x", "SECRET_ACCESS_KEY": "y"}
    for name, value in {**settings, "DEFAULT_REGION": "us-east-1"}.items():
        monkeypatch.setenv(f"AWS_{name}", value)
    s3fs.S3FileSystem.clear_instance_cache()
    files = s3fs.S3FileSystem()
    if files.exists("lab"):
        files.rm("lab", recursive=True)
    files.mkdir("lab")
    return "s3://lab"


@pytest.fixture(params=["memory", "file", "s3"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Of a storage of each kind that can be written."""
    s3 = request.param == "s3"
    found = f"{request.getfixturevalue('s3_bucket') if s3 else f'{request.param}://{tmp_path}'}/all"
    check_storage(found)
    return found
