from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.data.splat_files import columns_of, ply_bytes
from tests.gaussians.some import some_gaussians

from pcore.data import compressed_gaussians
from pcore.data.compressed_gaussians import read_compressed
from pcore.errors import DependencyError, InputError

gaussforge = pytest.importorskip("gaussforge")

TOLERANCE = {"compressed.ply": 0.02, "spz": 0.04, "sog": 0.04}


@pytest.fixture(scope="module")
def gaussians():
    return some_gaussians(600, dtype=torch.float64)


@pytest.fixture(scope="module")
def contents(gaussians):
    # Its writer takes quaternions for units.
    source = ply_bytes(columns_of(gaussians, unit=True))
    convert = gaussforge.GaussForge().convert
    made = {kind: bytes(convert(source, "ply", kind)["data"]) for kind in TOLERANCE}
    # It writes these by coefficient; SuperSplat's files have all of red first, as PLY has.
    rest = gaussians.sh[:, 1:].transpose(1, 2).reshape(600, 45).numpy()
    packed = np.clip((rest / 8 + 0.5) * 256, 0, 255).astype(np.uint8).tobytes()
    made["compressed.ply"] = made["compressed.ply"][: -len(packed)] + packed
    return made


@pytest.mark.parametrize("kind", TOLERANCE)
def test_compressed_files_are_read(kind: str, contents, gaussians):
    found = read_compressed(contents[kind], kind, "a").gaussians
    assert len(found) == 600
    # Some formats change the order.
    distance = torch.cdist(gaussians.means, found.means)
    nearest = distance.argmin(dim=1)
    assert float(distance.amin(dim=1).max()) < 0.01
    logs = (found.scales[nearest].log() - gaussians.scales.log()).abs()
    assert float(logs.max()) < TOLERANCE[kind]
    same = (found.quats[nearest] * gaussians.quats).sum(dim=1).abs()
    assert float(same.min()) > 0.999
    assert float((found.sh[nearest] - gaussians.sh).abs().median()) < 0.03
    assert found.degree == 3


@pytest.mark.parametrize("kind", TOLERANCE)
def test_splats_without_harmonics_are_read(kind: str, gaussians):
    flat = replace(gaussians, sh=gaussians.sh[:, :1])
    source = ply_bytes(columns_of(flat, unit=True))
    content = bytes(gaussforge.GaussForge().convert(source, "ply", kind)["data"])
    found = read_compressed(content, kind, "a").gaussians
    assert (len(found), found.degree) == (600, 0)
    distance = torch.cdist(flat.means, found.means)
    assert float(distance.amin(dim=1).max()) < 0.01
    nearest = distance.argmin(dim=1)
    assert float((found.sh[nearest] - flat.sh).abs().median()) < 0.03
    logs = (found.scales[nearest].log() - flat.scales.log()).abs()
    assert float(logs.max()) < TOLERANCE[kind]
    same = (found.quats[nearest] * flat.quats).sum(dim=1).abs()
    assert float(same.min()) > 0.999
    assert float((found.opacities[nearest] - flat.opacities).abs().max()) < 0.01


def test_compressed_ply_without_ranges_of_colors_is_read():
    # Without ranges of colours: one chunk of 12 numbers, colours of 0 to 1.
    names = [
        f"{e}_{what}{axis}" for what in ("", "scale_") for e in ("min", "max") for axis in "xyz"
    ]
    packed = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
    lines = ["ply", "format binary_little_endian 1.0", "element chunk 1"]
    lines += [f"property float {name}" for name in names]
    lines += ["element vertex 2", *(f"property uint {name}" for name in packed), "end_header", ""]
    ranges = np.array([0] * 3 + [2] * 3 + [-3] * 3 + [-1] * 3, dtype="<f4").tobytes()
    middle = 1 << 29 | 512 << 20 | 512 << 10 | 512
    rows = np.array([[0, middle, 0, 0xFF0000FF], [2**32 - 1, middle, 0, 0xFF0000FF]], dtype="<u4")
    content = "\n".join(lines).encode() + ranges + rows.tobytes()
    found = read_compressed(content, "compressed.ply", "a").gaussians
    assert found.degree == 0
    torch.testing.assert_close(found.means, torch.tensor([[0.0] * 3, [2.0] * 3]).double())
    color = found.sh[0, 0] * 0.28209479 + 0.5
    torch.testing.assert_close(color.double(), torch.tensor([1.0, 0.0, 0.0]).double())


@pytest.mark.parametrize("kind", TOLERANCE)
def test_damaged_files_are_refused(kind: str, contents):
    with pytest.raises(InputError, match="damaged"):
        read_compressed(contents[kind][: len(contents[kind]) // 3], kind, "a")
    noise = np.random.default_rng(0).integers(0, 256, 500, dtype=np.uint8).tobytes()
    with pytest.raises(InputError, match="damaged"):
        read_compressed(noise, kind, "a")


def test_a_missing_package_is_named(contents, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(compressed_gaussians.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(DependencyError, match=r"pcore-edit\[splats\]"):
        read_compressed(contents["spz"], "spz", "a.spz")
