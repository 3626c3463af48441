from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.data.splat_files import splat_bytes, write_ply
from tests.gaussians.some import some_gaussians

from pcore.data.points import save_points
from pcore.data.splat_formats import holds_splats, read_splats, save_splats
from pcore.errors import InputError


def test_files_are_told_apart(tmp_path: Path):
    write_ply(tmp_path / "scan.ply", some_gaussians(5))
    save_points(tmp_path / "points.ply", torch.rand(5, 3))
    (tmp_path / "broken.ply").write_bytes(b"ply\nformat")
    assert holds_splats(tmp_path / "scan.ply")
    assert holds_splats(tmp_path / "no.splat")
    assert not holds_splats(tmp_path / "points.ply")
    assert not holds_splats(tmp_path / "broken.ply")
    assert not holds_splats(tmp_path / "no.ply")
    assert not holds_splats(tmp_path / "points.npy")


def test_the_chunk_of_supersplat_is_seen(tmp_path: Path):
    head = "ply\nformat binary_little_endian 1.0\nelement chunk 1\nproperty float min_x\n"
    head += "element vertex 1\nproperty uint packed_position\nend_header\n"
    (tmp_path / "a.ply").write_bytes(head.encode() + bytes(8))
    assert holds_splats(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a.ksplat", "are not read: export"),
        ("a.obj", "ends in"),
        ("missing.ply", "no such file"),
        ("points.ply", "bare points"),
    ],
)
def test_what_is_not_read_is_named(tmp_path: Path, name: str, message: str):
    save_points(tmp_path / "points.ply", torch.rand(5, 3))
    with pytest.raises(InputError, match=message):
        read_splats(tmp_path / name)


@pytest.mark.parametrize("ending", [".ply", ".splat"])
def test_what_is_written_is_read(tmp_path: Path, ending: str):
    write_ply(tmp_path / "scan.ply", some_gaussians(40))
    file = read_splats(tmp_path / "scan.ply")
    notes = save_splats(tmp_path / f"out{ending}", file)
    again = read_splats(tmp_path / f"out{ending}").gaussians
    torch.testing.assert_close(again.means.float(), file.gaussians.means.float())
    assert bool(notes) == (ending == ".splat")  # Which has no harmonics.
    assert not list(tmp_path.glob(".*"))


def test_a_splat_becomes_a_ply_that_trainers_read(tmp_path: Path):
    (tmp_path / "a.splat").write_bytes(splat_bytes(30))
    file = read_splats(tmp_path / "a.splat")
    save_splats(tmp_path / "a.ply", file)
    again = read_splats(tmp_path / "a.ply").gaussians
    torch.testing.assert_close(again.scales, file.gaussians.scales, rtol=1e-5, atol=0)
    torch.testing.assert_close(again.sh, file.gaussians.sh, rtol=1e-5, atol=1e-6)


def test_gltf_is_written(tmp_path: Path):
    write_ply(tmp_path / "scan.ply", some_gaussians(4, degree=4))
    notes = save_splats(tmp_path / "a.glb", read_splats(tmp_path / "scan.ply"))
    assert (tmp_path / "a.glb").read_bytes()[:4] == b"glTF"
    assert "degree 4" in notes[0]


def test_compressed_outputs_and_missing_folders_are_refused(tmp_path: Path):
    write_ply(tmp_path / "scan.ply", some_gaussians(4))
    file = read_splats(tmp_path / "scan.ply")
    with pytest.raises(InputError, match="compress it afterwards"):
        save_splats(tmp_path / "a.spz", file)
    with pytest.raises(InputError, match="existing folder"):
        save_splats(tmp_path / "none" / "a.ply", file)


def test_mutated_files_end_in_gaussians_or_an_input_error(tmp_path: Path):
    source = np.random.default_rng(3)
    write_ply(tmp_path / "scan.ply", some_gaussians(6, degree=1))
    contents = {".ply": (tmp_path / "scan.ply").read_bytes(), ".splat": splat_bytes(6)}
    ends = set()
    for number in range(300):
        ending = (".ply", ".splat")[number % 2]
        content = bytearray(contents[ending])
        for _ in range(source.integers(1, 12)):
            content[source.integers(len(content))] = source.integers(256)
        if number % 5 == 0:
            content = content[: source.integers(len(content))]
        (tmp_path / f"m{ending}").write_bytes(bytes(content))
        try:
            file = read_splats(tmp_path / f"m{ending}")
            save_splats(tmp_path / "out.ply", replace(file, notes=()))
            ends.add("read")
        except InputError:
            ends.add("refused")
    assert ends == {"read", "refused"}
