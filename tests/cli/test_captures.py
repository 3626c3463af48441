"""Captures on the command line: what is said of them, and both kinds of object learn from them."""

from pathlib import Path

import pytest

from capture_files import HEIGHT, WIDTH, shots, write_model, write_ngp, write_photos
from pcore.cli.main import main


def test_info_says_what_is_not_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_ngp(tmp_path, k1=0.1)
    (tmp_path / "images" / "img_3.png").unlink()
    assert main(["info", str(tmp_path)]) == 0
    said = {line.split("  ")[0]: line for line in capsys.readouterr().out.splitlines()}
    assert said["layout"].endswith("transforms.json")
    assert said["views"].endswith("7 train, 2 test")
    assert said["lenses"].endswith("9 of 9 views are straightened")
    assert said["not used"].endswith("1 photos")
    assert said["not used: images/img_3.png"].endswith("no file in the folder")


def test_info_finds_no_poses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_photos(tmp_path, ["a.png", "b.png", "c.png"])
    assert main(["info", str(tmp_path)]) == 0
    assert "folder of photos, without poses" in capsys.readouterr().out


@pytest.mark.parametrize("model", ["gaussians", "papr"])
def test_bent_photos_of_two_sizes_train(
    model: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photos = shots(12)
    for shot in photos[6:]:
        shot.camera = 2
    names = [shot.name for shot in photos]
    write_photos(tmp_path / "cap" / "images", names[:6])
    write_photos(tmp_path / "cap" / "images", names[6:], size=(16, 24))
    cameras = {
        1: ("SIMPLE_RADIAL", WIDTH, HEIGHT, [30.0, 12.0, 8.0, 0.1]),
        2: ("OPENCV", 16, 24, [33.0, 32.0, 7.0, 13.0, 0.1, 0.0, 0.0, 0.0]),
    }
    write_model(tmp_path / "cap" / "sparse" / "0", photos, cameras)
    words = ["train", str(tmp_path / "cap"), "-o", str(tmp_path / "run"), "--model", model]
    words += ["--steps", "3", "--points", "60", "--no-tensorboard", "--threads", "1"]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "(and 1 other size)" in said
    if model == "papr":
        return  # After three steps there is nothing to be seen.
    words = ["render", str(tmp_path / "run"), "--split", "test", "-o", str(tmp_path / "out")]
    assert main([*words, "--threads", "1"]) == 0
    assert len(list((tmp_path / "out").rglob("*.png"))) >= 2
