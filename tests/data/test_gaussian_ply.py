from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.data.splat_files import columns_of, ply_bytes, read_plain
from tests.gaussians.some import some_gaussians

from pcore.data.gaussian_ply import gaussian_ply, is_gaussian, lost, read_gaussian_ply
from pcore.data.ply import parse_ply
from pcore.errors import InputError


def read(content: bytes):
    return read_gaussian_ply(parse_ply(content, "a.ply"), "a.ply")


@pytest.mark.parametrize("degree", range(5))
@pytest.mark.parametrize("order", ["<", ">", "a"])
def test_files_of_inria_are_read(degree: int, order: str):
    gaussians = some_gaussians(20, degree=degree, dtype=torch.float64)
    found = read(ply_bytes(columns_of(gaussians), order=order)).gaussians
    assert found.degree == degree
    for name, value in vars(gaussians).items():
        got = getattr(found, name).double()
        torch.testing.assert_close(got, value, atol=1e-6, rtol=1e-5, msg=name)
    torch.testing.assert_close(found.quats.norm(dim=1), torch.ones(20, dtype=torch.float64))


def test_what_is_written_without_a_source_is_what_the_trainers_write():
    gaussians = some_gaussians(20)
    wide = gaussians.to(dtype=torch.float64)
    file = read(ply_bytes(columns_of(wide)))
    content = gaussian_ply(replace(file, gaussians=gaussians, ply=None))
    expected, found = columns_of(wide), read_plain(content)
    assert list(found) == list(expected)  # Order counts: one viewer reads by place.
    for name in expected:
        if not name.startswith("rot_"):  # Any length is right.
            np.testing.assert_allclose(found[name], expected[name], atol=1e-5, err_msg=name)
    again = read(content).gaussians
    torch.testing.assert_close(again.quats, wide.quats, atol=1e-6, rtol=0)


def test_two_scales_are_flat_gaussians_and_stay_two():
    gaussians = some_gaussians(20, dtype=torch.float64)
    file = read(ply_bytes(columns_of(gaussians, flat=True)))
    torch.testing.assert_close(
        file.gaussians.scales[:, :2], gaussians.scales[:, :2], atol=0, rtol=1e-5
    )
    assert bool((file.gaussians.scales[:, 2] < 1e-3 * gaussians.scales[:, :2].amin(dim=1)).all())
    written = read_plain(gaussian_ply(file))
    assert "scale_2" not in written
    assert "scale_2" not in read_plain(gaussian_ply(replace(file, ply=None)))


def test_colours_without_harmonics_are_read():
    columns = columns_of(some_gaussians(4, degree=0, dtype=torch.float64))
    columns = {k: v for k, v in columns.items() if not k.startswith("f_")}
    columns |= {"red": np.full(4, 255.0), "green": np.full(4, 127.5), "blue": np.zeros(4)}
    found = read(ply_bytes(columns)).gaussians
    shown = 0.5 + 0.28209479177387814 * found.sh[:, 0]
    torch.testing.assert_close(shown, torch.tensor([1.0, 0.5, 0.0]).expand(4, 3))


def test_everything_else_of_the_file_stays():
    columns = columns_of(some_gaussians(5, degree=1, dtype=torch.float64))
    columns["filter_3D"] = np.arange(5.0)
    tail = "element camera 1\nproperty float focal\n"
    content = ply_bytes(columns, tail=tail) + np.array([42.0], "<f4").tobytes()
    file = read(content)
    written = gaussian_ply(file)
    assert written[: content.index(b"end_header")] == content[: content.index(b"end_header")]
    assert written[-4:] == content[-4:]
    np.testing.assert_array_equal(read_plain(written)["filter_3D"], np.arange(5.0))
    assert not lost(file)
    part = file.chosen(np.array([0, 1, 1, 4]))
    rows = read_plain(gaussian_ply(part))
    assert rows["filter_3D"].tolist() == [0, 1, 1, 4]
    assert lost(part) == ("1 camera",)


def test_types_of_the_file_stay():
    columns = columns_of(some_gaussians(3, degree=0, dtype=torch.float64))
    content = ply_bytes(columns).replace(b"property float x\n", b"property double x\n", 1)
    head = content.index(b"end_header\n") + 11
    rows = np.frombuffer(content[head:], "<f4").reshape(3, -1)
    wide = b"".join(np.float64(float(row[0]) + 5e6).tobytes() + row[1:].tobytes() for row in rows)
    file = read(content[:head] + wide)
    assert float(file.gaussians.means[0, 0]) == float(rows[0, 0]) + 5e6
    part = read_plain(gaussian_ply(file.chosen(np.array([2, 1]))))
    assert part["x"].dtype == np.float64
    assert float(part["x"][0]) == float(rows[2, 0]) + 5e6


def test_normals_are_turned_and_zeros_stay():
    columns = columns_of(some_gaussians(2, degree=0, dtype=torch.float64))
    assert read(ply_bytes(columns)).normals is None
    columns |= {"nx": np.ones(2)}
    file = read(ply_bytes(columns))
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    moved = file.moved(file.gaussians, np.stack([quarter, quarter]))
    np.testing.assert_allclose(read_plain(gaussian_ply(moved))["ny"], 1.0)


@pytest.mark.parametrize("missing", ["x", "opacity", "rot_3", "scale_1", "f_dc_2"])
def test_missing_properties_are_named(missing: str):
    columns = columns_of(some_gaussians(3, dtype=torch.float64))
    del columns[missing]
    with pytest.raises(InputError, match=f"got no .*{missing}"):
        read(ply_bytes(columns))


def test_whole_numbers_are_no_gaussians():
    content = ply_bytes(columns_of(some_gaussians(3, dtype=torch.float64)))
    with pytest.raises(InputError, match="other types in rot_2"):
        read(content.replace(b"property float rot_2", b"property int rot_2"))


@pytest.mark.parametrize("count", [1, 10, 12, 44])
def test_harmonics_that_fit_no_degree_are_refused(count: int):
    columns = columns_of(some_gaussians(3, degree=0, dtype=torch.float64))
    columns |= {f"f_rest_{k}": np.zeros(3) for k in range(count)}
    with pytest.raises(InputError, match=rf"0, 9, 24, 45 or 72 .* got {count}"):
        read(ply_bytes(columns))


@pytest.mark.parametrize(
    ("name", "value"),
    [("x", np.nan), ("scale_1", np.inf), ("scale_0", 60.0), ("f_rest_3", -np.inf)],
)
def test_a_few_broken_ones_are_left_out_and_told(name: str, value: float):
    columns = columns_of(some_gaussians(10, dtype=torch.float64))
    columns[name][4] = value
    file = read(ply_bytes(columns))
    assert file.rows.tolist() == [0, 1, 2, 3, 5, 6, 7, 8, 9]
    assert "1 of 10" in file.notes[0]
    assert len(read_plain(gaussian_ply(file))["x"]) == 9


def test_quaternions_without_length_are_left_out():
    columns = columns_of(some_gaussians(10, dtype=torch.float64))
    for k in range(4):
        columns[f"rot_{k}"][2] = 0
    assert 2 not in read(ply_bytes(columns)).rows


def test_mostly_broken_files_are_refused():
    columns = columns_of(some_gaussians(10, dtype=torch.float64))
    columns["y"][:6] = np.nan
    with pytest.raises(InputError, match="6 of 10"):
        read(ply_bytes(columns))


def test_nothing_to_be_seen_is_refused():
    columns = columns_of(some_gaussians(10, dtype=torch.float64))
    columns["opacity"][:] = -np.inf
    with pytest.raises(InputError, match="opacity 0 in all 10"):
        read(ply_bytes(columns))
    columns["opacity"][:] = -60.0
    with pytest.raises(InputError, match=r"opacities of at most .*1 / 255"):
        read(ply_bytes(columns))
    with pytest.raises(InputError, match="at least one Gaussian, got none"):
        read(ply_bytes({name: values[:0] for name, values in columns.items()}))
    columns["opacity"][0] = np.inf  # Opacity 1, as converters write it.
    assert float(read(ply_bytes(columns)).gaussians.opacities[0]) == 1.0


def test_truncated_files_are_refused():
    content = ply_bytes(columns_of(some_gaussians(10, dtype=torch.float64)))
    with pytest.raises(InputError, match=r"a\.ply"):
        read(content[:-100])


def test_points_are_no_gaussians():
    columns = {name: np.zeros(3) for name in ("x", "y", "z", "opacity")}
    assert not is_gaussian(parse_ply(ply_bytes(columns), "a.ply"))
    assert not is_gaussian(parse_ply(b"ply\nformat ascii 1.0\nend_header\n", "a.ply"))
