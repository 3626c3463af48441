"""Nearest-to-ray search: every backend against brute force in float64."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.kernels import backends
from pcore.kernels.backends import backend, usable
from pcore.kernels.functional import nearest_to_rays

BACKENDS = usable(torch.device("cpu"))


@pytest.fixture(params=BACKENDS, autouse=True)
def kernels(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("PCORE_KERNELS", request.param)
    return request.param


def distances(origins: Tensor, directions: Tensor, points: Tensor) -> np.ndarray:
    """(R, N) distances to the infinite lines, by cross products in float64."""
    o, d, p = (x.double().numpy() for x in (origins, directions, points))
    return np.linalg.norm(np.cross(p[None] - o[:, None], d[:, None]), axis=-1)


def rays(count: int, *, spread: float = 3.0) -> tuple[Tensor, Tensor]:
    directions = torch.nn.functional.normalize(torch.randn(count, 3), dim=-1)
    return torch.randn(count, 3) * spread, directions


def check(origins: Tensor, directions: Tensor, points: Tensor, k: int) -> Tensor:
    """Assert that the k chosen points are as near as the nearest k, in order."""
    found = nearest_to_rays(origins, directions, points, k)
    distance = distances(origins, directions, points)
    chosen = np.take_along_axis(distance, found.numpy(), axis=-1)
    best = np.sort(distance, axis=-1)[:, :k]
    # Distances, not indices: two points may be closer to each other than float32 can tell.
    np.testing.assert_allclose(chosen, best, atol=2e-6 * (1 + np.abs(origins.numpy()).max()))
    assert found.dtype == torch.int64
    assert all(len(set(row)) == found.shape[-1] for row in found.tolist()), "no point twice"
    return found


@pytest.mark.parametrize(
    ("count", "points", "k"), [(1, 1, 1), (1, 7, 1), (5, 123, 3), (65, 400, 20), (130, 50, 50)]
)
def test_agrees_with_brute_force(count: int, points: int, k: int) -> None:
    found = check(*rays(count), torch.randn(points, 3), k)
    assert found.shape == (count, k)


def test_indices_are_those_of_brute_force_when_distances_are_clear() -> None:
    origin, direction = torch.tensor([[0.0, 0.0, 5.0]]), torch.tensor([[0.0, 0.0, -1.0]])
    points = torch.tensor([[3.0, 0, 0], [0.1, 0, 2], [0, -2.0, 1], [0, 0.5, -4]])
    assert nearest_to_rays(origin, direction, points, 3).tolist() == [[1, 3, 2]]


def test_k_is_at_most_the_number_of_points() -> None:
    assert check(*rays(4), torch.randn(3, 3), 3).shape == (4, 3)
    assert nearest_to_rays(*rays(4), torch.randn(3, 3), 20).shape == (4, 3)


def test_equal_distances_come_in_order_of_the_index() -> None:
    origin, direction = torch.tensor([[0.0, 0.0, 5.0]]), torch.tensor([[0.0, 0.0, -1.0]])
    near, far = [0.5, 0.0, 0.0], [2.0, 0.0, 0.0]
    points = torch.tensor([far, near, near, far, near, far])
    assert nearest_to_rays(origin, direction, points, 5).tolist() == [[1, 2, 4, 0, 3]]
    # The cut through a group of equals keeps its first ones.
    assert nearest_to_rays(origin, direction, points, 2).tolist() == [[1, 2]]


def test_all_points_in_one_place() -> None:
    found = nearest_to_rays(*rays(3), torch.ones(9, 3), 4)
    assert found.tolist() == [[0, 1, 2, 3]] * 3


def test_camera_inside_the_cloud() -> None:
    check(*rays(40, spread=0.1), torch.randn(200, 3), 8)


def test_points_behind_the_camera_count() -> None:
    """The ray is an infinite line, as in the original."""
    origin, direction = torch.tensor([[0.0, 0.0, 0.0]]), torch.tensor([[0.0, 0.0, -1.0]])
    points = torch.tensor([[0.3, 0.0, -4.0], [0.1, 0.0, 9.0], [0.2, 0.0, -4.0]])
    assert nearest_to_rays(origin, direction, points, 2).tolist() == [[1, 2]]


def test_far_origins_do_not_cancel() -> None:
    """|v|^2 - (v.d)^2 would lose all digits here."""
    directions = torch.nn.functional.normalize(torch.tensor([[0.1, 0.2, -1.0]]), dim=-1)
    points = torch.randn(100, 3) * 0.01
    found = nearest_to_rays(-300 * directions, directions, points, 5)
    distance = distances(-300 * directions, directions, points)
    assert np.take_along_axis(distance, found.numpy(), -1).max() < 1.1 * np.sort(distance)[0, 4]


def test_non_contiguous_input_and_batch_shape() -> None:
    origins, directions = rays(24)
    points = torch.randn(60, 3)
    expected = nearest_to_rays(origins, directions, points, 6)
    shown = nearest_to_rays(
        origins.T.contiguous().T.reshape(4, 6, 3),
        directions.repeat_interleave(2, dim=0)[::2].reshape(4, 6, 3),
        torch.cat([points, points], dim=1)[:, :3],
        6,
    )
    assert shown.shape == (4, 6, 6)
    assert torch.equal(shown.reshape(24, 6), expected)


def test_expanded_origins() -> None:
    _, directions = rays(12)
    one = torch.tensor([0.0, 1.0, 4.0])
    found = nearest_to_rays(one.expand(12, 3), directions, torch.randn(30, 3), 4)
    assert found.shape == (12, 4)


def test_no_rays() -> None:
    assert nearest_to_rays(torch.ones(0, 3), torch.ones(0, 3), torch.ones(5, 3), 2).shape == (0, 2)


def test_backends_choose_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    origins, directions, points = *rays(200), torch.randn(300, 3)
    found: list[Tensor] = []
    for name in BACKENDS:
        monkeypatch.setenv("PCORE_KERNELS", name)
        found.append(nearest_to_rays(origins, directions, points, 10))
    same = (found[0] == found[1]).all(dim=-1).double().mean()
    assert same > 0.99, "only ties within float32 may differ"
    chosen = [
        np.take_along_axis(distances(origins, directions, points), f.numpy(), -1) for f in found
    ]
    np.testing.assert_allclose(chosen[0], chosen[1], atol=1e-5)


@pytest.mark.parametrize(("points", "k"), [(0, 3), (4, 0)])
def test_empty_cloud_and_k(points: int, k: int) -> None:
    message = rf"expected at least one point and k >= 1, got {points} points and k = {k}"
    with pytest.raises(InputError, match=message):
        nearest_to_rays(*rays(2), torch.ones(points, 3), k)


@pytest.mark.parametrize("name", ["cpu", "triton"])
def test_backend_that_cannot_work_on_the_device(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PCORE_KERNELS", name)
    monkeypatch.setattr(backends, "has_triton", lambda: True)
    kind = "cuda" if name == "cpu" else "cpu"
    with pytest.raises(InputError, match=rf"PCORE_KERNELS: .* tensors on {kind}, got '{name}'"):
        backend(torch.device(kind))


def test_the_best_usable_backend_is_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PCORE_KERNELS")
    assert backend(torch.device("cpu")) == "cpu"
    for there, expected in ((True, "triton"), (False, "reference")):
        monkeypatch.setattr(backends, "has_triton", lambda there=there: there)
        assert backend(torch.device("cuda")) == expected
        assert backend(torch.device("mps")) == "reference"


def test_double_precision_is_not_rounded() -> None:
    """Distances that float32 cannot tell apart, in any of the inputs."""
    origin = torch.tensor([[0.0, 0.0, 5.0]], dtype=torch.float64)
    direction = torch.tensor([[0.0, 0.0, -1.0]], dtype=torch.float64)
    points = torch.zeros(50, 3, dtype=torch.float64)
    points[:, 0] = 0.5 - 1e-12 * torch.arange(50, dtype=torch.float64)
    found = nearest_to_rays(origin, direction, points, 5)
    assert found.tolist() == [[49, 48, 47, 46, 45]]
    moved = nearest_to_rays(origin + points[40] - 0.5, direction, points.float(), 5)
    assert moved.shape == (1, 5)


def test_what_triton_does_not_search_the_reference_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backends, "backend", lambda device: "triton")
    one, double = torch.zeros(4, 3), torch.zeros(4, 3, dtype=torch.float64)
    assert backends.of_search(one, one, one, 64) == "triton"
    assert backends.of_search(one, one, one, 65) == "reference"
    for given in ((double, one, one), (one, double, one), (one, one, double)):
        assert backends.of_search(*given, 5) == "reference"
    assert backends.of_search(one.half(), one.half(), one.half(), 5) == "reference"


def test_unknown_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PCORE_KERNELS", "gpu")
    with pytest.raises(InputError, match=r"PCORE_KERNELS: expected one of .*, got 'gpu'"):
        backend(torch.device("cpu"))
