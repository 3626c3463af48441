import numpy as np
import pytest
import torch
from tests.data.splat_files import splat_bytes
from tests.gaussians.some import some_gaussians

from pcore.data.splat_formats import read_splat, splat_content
from pcore.errors import InputError


def test_a_row_means_what_the_format_says():
    row = np.array([1, 2, 3, 0.1, 0.2, 0.3], "<f4").tobytes() + bytes([255, 0, 51, 204])
    found = read_splat(row + bytes([128, 128, 0, 128]), "a.splat").gaussians
    assert found.means.tolist() == [[1, 2, 3]]
    torch.testing.assert_close(found.scales.float(), torch.tensor([[0.1, 0.2, 0.3]]))
    assert found.quats.tolist() == [[0, 0, -1, 0]]
    torch.testing.assert_close(found.opacities, torch.tensor([0.8], dtype=torch.float64))
    shown = 0.5 + 0.28209479177387814 * found.sh[0, 0]
    torch.testing.assert_close(shown, torch.tensor([1.0, 0.0, 0.2]))


def test_reading_and_writing_changes_a_bit_of_the_quaternions_at_most():
    content = splat_bytes(200)
    again = splat_content(read_splat(content, "a.splat").gaussians)
    before, after = (
        np.frombuffer(c, np.uint8).reshape(-1, 32).astype(int) for c in (content, again)
    )
    assert (before[:, :28] == after[:, :28]).all()
    assert np.abs(before[:, 28:] - after[:, 28:]).max() <= 1


def test_harmonics_are_written_as_their_mean_colour():
    gaussians = some_gaussians(50)
    found = read_splat(splat_content(gaussians), "a.splat").gaussians
    shown, expected = (0.5 + 0.2820948 * g.sh[:, 0] for g in (found, gaussians))
    torch.testing.assert_close(shown, expected.clamp(0, 1), atol=0.5 / 255 + 1e-6, rtol=0)
    torch.testing.assert_close(found.quats.float(), gaussians.quats, atol=0.02, rtol=0)


@pytest.mark.parametrize("size", [0, 31, 33])
def test_half_gaussians_are_refused(size: int):
    with pytest.raises(InputError, match="32 bytes"):
        read_splat(splat_bytes(2)[:size], "a.splat")


def test_invisible_and_broken_ones_are_refused_or_left_out():
    rows = np.frombuffer(splat_bytes(10), np.uint8).reshape(10, 32).copy()
    rows[3, 28:] = 128
    assert 3 not in read_splat(rows.tobytes(), "a.splat").rows
    rows[:, 27] = 0
    with pytest.raises(InputError, match="opacity 0"):
        read_splat(rows.tobytes(), "a.splat")
