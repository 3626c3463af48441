"""Samples of the true surface."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks.surface_samples import load_samples

from pcore.errors import SceneError
from pcore.evaluation.ground_truth import load_truth

ARRAYS = {
    "canonical": np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    "up": np.array([[0.0, 0, 2], [1, 0, 2], [0, 1, 2], [0, 0, 3]]),
    "faces": np.array([[0, 1, 2], [0, 1, 3]]),
    "sample_face": np.array([1, 0, 0]),
    "sample_barycentric": np.array([[0.0, 0, 1], [0.5, 0.5, 0], [1, 0, 0]], dtype=np.float32),
    "sample_visible": np.array([True, True, False]),
}


def write(folder: Path, **changes: object) -> Path:
    content = {k: v for k, v in {**ARRAYS, **changes}.items() if v is not None}
    np.savez(folder / "meshes.npz", **content)
    return folder


def test_only_visible_samples_and_they_follow_the_state(tmp_path: Path) -> None:
    root = write(tmp_path)
    samples = load_samples(root)
    truth = load_truth(root)
    np.testing.assert_allclose(samples.positions(truth, None), [[0, 0, 1], [0.5, 0, 0]])
    np.testing.assert_allclose(samples.positions(truth, "up"), [[0, 0, 3], [0.5, 0, 2]])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sample_face": None}, "got no sample_face"),
        ({"sample_visible": np.array([True])}, r"expected sample_face \(T,\)"),
        ({"sample_face": np.array([1, 2, 0])}, "expected visible samples on triangles 0 to 1"),
        ({"sample_visible": np.zeros(3, dtype=bool)}, "got 0 of 3 visible"),
    ],
)
def test_bad_files(tmp_path: Path, changes: dict, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        load_samples(write(tmp_path, **changes))
    with pytest.raises(SceneError, match="not found"):
        load_samples(tmp_path / "nowhere")


def test_real_samples_lie_on_the_mesh(shared_data: Path) -> None:
    root = shared_data / "deformed" / "robot"
    samples, truth = load_samples(root), load_truth(root)
    found = samples.positions(truth, "wave")
    assert 40_000 < len(found) < 50_000
    low, high = truth.vertices("wave").min(axis=0), truth.vertices("wave").max(axis=0)
    assert (found >= low - 1e-6).all()
    assert (found <= high + 1e-6).all()
