import json
from importlib.resources import as_file, files
from pathlib import Path

import pytest

from pcore.cli.main import main

TWIST = {"type": "twist", "axis": "z", "angle_deg": {"keyframes": [[0, 0], [1, 30]]}}


@pytest.fixture
def run() -> Path:
    with as_file(files("pcore.studio").joinpath("demo_run")) as folder:
        return Path(folder)


def test_it_writes_one_file_and_says_how_large_it_is(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edit, page = tmp_path / "edit.json", tmp_path / "toy.html"
    edit.write_text(json.dumps({"version": 2, "edits": [TWIST]}))
    words = ["view", str(run), "--edit", str(edit), "--frames", "3", "--html", str(page)]
    assert main(words) == 0
    content = page.read_bytes()
    assert b'"moments": 3' in content
    assert f"{len(content) / 1e6:.1f} MB, opens in any browser" in capsys.readouterr().out
    assert main([*words, "--time", "0.5"]) == 0
    assert b'"moments": 1' in page.read_bytes()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--frames", "1"], "expected at least 2, got 1"),
        (["--seconds", "0"], "expected a positive number"),
        (["--megabytes", "0.01"], "expected at least 0.2"),
        (["--html", "none/toy.html"], "expected an existing folder"),
        (["--port", "0"], "expected a number from 1 to 65535"),
        (["--host", "203.0.113.1"], "cannot listen there"),
    ],
)
def test_what_makes_no_page_is_refused(
    run: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["view", str(run), *words]) != 0
    output = capsys.readouterr()
    assert said in " ".join((output.out + output.err).split())


@pytest.mark.parametrize("words", [[], ["RUN", "--demo"]])
def test_the_studio_wants_a_run_or_the_demo(
    run: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    assert main(["studio", *[str(run) if word == "RUN" else word for word in words]]) != 0
    assert "or --demo" in capsys.readouterr().err
