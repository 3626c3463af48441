"""`pcore deform` of files of Gaussians."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.data.splat_files import columns_of, ply_bytes, read_plain, splat_bytes, write_ply
from tests.gaussians.some import some_gaussians

from pcore.cli.deform import DeformCommand
from pcore.cli.deform_gaussians import deform
from pcore.data.points import save_points
from pcore.data.splat_formats import read_splats
from pcore.errors import EditError, InputError

TWIST = {"type": "twist", "axis": "z", "angle_deg": 60}
STRETCH = {"type": "stretch", "axis": "z", "factor": 1.0, "profile": "axial"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_ply(tmp_path / "gs.ply", some_gaussians(30))
    write_edit(tmp_path, TWIST)
    return tmp_path


def write_edit(folder: Path, *edits: dict) -> None:
    (folder / "edit.json").write_text(json.dumps({"version": 2, "edits": edits}))


def run(folder: Path, source: str = "gs.ply", output: str = "out.ply", **options) -> Path:
    deform(
        DeformCommand(
            input=folder / source, edit=folder / "edit.json", output=folder / output, **options
        )
    )
    return folder / output


def test_nothing_of_a_trainer_s_file_is_lost(folder: Path, capsys: pytest.CaptureFixture[str]):
    before = read_plain((folder / "gs.ply").read_bytes())
    after = read_plain(run(folder).read_bytes())
    assert list(after) == list(before)
    changed = {name for name in before if not np.allclose(before[name], after[name], atol=1e-6)}
    assert {"x", "y", "rot_0", "scale_0", "f_rest_0"} <= changed
    assert not {"z", "nx", "f_dc_0", "opacity"} & changed
    printed = capsys.readouterr().out
    assert "30 Gaussians, harmonics of degree 3, twist" in printed
    assert "out.ply" in printed


def test_lengths_along_a_stretch_double(folder: Path):
    write_edit(folder, STRETCH)
    before, after = (read_splats(p).gaussians for p in (folder / "gs.ply", run(folder)))
    volume = after.scales.prod(dim=1) / before.scales.prod(dim=1)
    torch.testing.assert_close(volume, torch.full_like(volume, 2.0), rtol=1e-4, atol=0)


def test_splats_in_and_out(folder: Path, capsys: pytest.CaptureFixture[str]):
    (folder / "a.splat").write_bytes(splat_bytes(20))
    assert len(run(folder, "a.splat", "b.splat").read_bytes()) == 20 * 32
    capsys.readouterr()
    run(folder, "gs.ply", "c.splat")
    assert "note: a .splat file has one colour" in capsys.readouterr().out
    assert run(folder, "a.splat", "d.glb").read_bytes()[:4] == b"glTF"


def test_keyframes_need_a_time(folder: Path):
    keys = {"keyframes": [[0, 0], [1, 60]]}
    write_edit(folder, {**TWIST, "angle_deg": keys})
    with pytest.raises(EditError, match="--time"):
        run(folder)
    at_end = run(folder, time=1.0).read_bytes()
    write_edit(folder, TWIST)
    assert run(folder).read_bytes() == at_end


def test_points_take_a_time_too_but_no_split(folder: Path):
    save_points(folder / "in.npy", torch.rand(20, 3))
    write_edit(folder, {**TWIST, "angle_deg": {"keyframes": [[0, 0], [1, 60]]}})
    run(folder, "in.npy", "out.npy", time=0.0)
    assert np.array_equal(np.load(folder / "out.npy"), np.load(folder / "in.npy"))
    with pytest.raises(InputError, match="--split"):
        run(folder, "in.npy", "out.npy", time=0.0, split=0.3)


def test_bends_are_told_and_split(folder: Path, capsys: pytest.CaptureFixture[str]):
    write_edit(folder, {"type": "bend", "axis": "x", "angle_deg": 80})
    run(folder)
    assert "--split 0.3 makes several" in capsys.readouterr().out
    content = run(folder, split=0.3).read_bytes()
    assert "were split; now" in capsys.readouterr().out
    assert len(read_plain(content)["x"]) > 30


def test_folds_are_told_or_refused(folder: Path, capsys: pytest.CaptureFixture[str]):
    write_edit(folder, {"type": "taper", "axis": "z", "factor": -2.5})
    run(folder)
    assert "turns it inside out at" in capsys.readouterr().out
    with pytest.raises(EditError):
        run(folder, strict=True)


def test_broken_gaussians_are_left_out_and_told(folder: Path, capsys: pytest.CaptureFixture[str]):
    columns = columns_of(some_gaussians(30, dtype=torch.float64))
    columns["scale_1"][3] = np.inf
    (folder / "bad.ply").write_bytes(ply_bytes(columns))
    assert len(read_plain(run(folder, "bad.ply").read_bytes())["x"]) == 29
    assert "note: 1 of 30 Gaussians" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("source", "output", "message"),
    [
        ("gs.ply", "out.npy", r"ends in \.ply, \.splat or \.glb"),
        ("gs.ply", "out.spz", "compress it afterwards"),
        ("gs.ply", "gs.ply", "other than the input"),
        ("a.ksplat", "out.ply", "are not read"),
        ("none.splat", "out.ply", "no such file"),
        ("a.glb", "out.splat", r"or Gaussians \(.ply, .splat, .spz, .sog\), got '.glb'"),
    ],
)
def test_what_cannot_be_is_refused(folder: Path, source: str, output: str, message: str):
    with pytest.raises(InputError, match=message):
        run(folder, source, output)
    assert not list(folder.glob("out*"))
