"""Rays of the rest state: the fast backend against the reference, the reference against the
formulas."""

from __future__ import annotations

from types import ModuleType

import pytest
import torch
from torch import Tensor

from pcore.geometry.rays import RayBundle
from pcore.kernels import cpu, cpu_pull_back, functional, reference


def scene(rays: int, points: int, candidates: int) -> dict[str, Tensor]:
    maps = torch.eye(3) + 0.3 * torch.randn(points, 3, 3)
    return {
        "origins": torch.randn(rays, 3) * 2,
        "directions": torch.nn.functional.normalize(torch.randn(rays, 3), dim=-1),
        "positions": torch.randn(points, 3) * 0.5,
        "rest": torch.randn(points, 3) * 0.5,
        "to_rest": maps,
        "candidates": torch.stack([torch.randperm(points)[:candidates] for _ in range(rays)])
        if rays
        else torch.zeros(0, candidates, dtype=torch.int64),
    }


@pytest.mark.parametrize("back_layer", [False, True])
@pytest.mark.parametrize(
    "layers",
    [
        None,
        (0.6, 0.7, 1.5),
        (2.0, 0.3, 0.8),
        (0.0, 0.3, 0.8),
    ],
)
@pytest.mark.parametrize(
    ("rays", "points", "candidates", "k"),
    [(37, 123, 11, 5), (300, 123, 40, 5), (1, 1, 1, 1), (0, 9, 4, 2), (5, 8, 8, 8)],
)
def test_backends_agree(
    rays: int,
    points: int,
    candidates: int,
    k: int,
    layers: tuple[float, float, float] | None,
    back_layer: bool,
) -> None:
    inputs = scene(rays, points, candidates)
    expected = reference.pull_back(**inputs, k=k, layers=layers, back_layer=back_layer)
    found = cpu_pull_back.pull_back(**inputs, k=k, layers=layers, back_layer=back_layer)
    for name, one, other in zip(
        ("neighbours", "", "counts", "has_back"), found, expected, strict=True
    ):
        if isinstance(one, RayBundle):
            assert isinstance(other, RayBundle)
            torch.testing.assert_close(one.origins, other.origins, rtol=1e-4, atol=1e-4)
            torch.testing.assert_close(one.directions, other.directions, rtol=1e-4, atol=1e-4)
        else:
            assert torch.equal(one, other), name


def test_a_pair_sees_the_ray_through_its_own_map() -> None:
    inputs = scene(4, 20, 7)
    neighbours, seen, counts, has_back = functional.pull_back(**inputs, k=3)
    assert counts.tolist() == [3] * 4
    assert not has_back.any()
    points = [inputs[name] for name in ("positions", "rest", "to_rest")]
    again = functional.rays_at_rest(inputs["origins"], inputs["directions"], *points, neighbours)
    torch.testing.assert_close(again.origins, seen.origins)
    torch.testing.assert_close(again.directions, seen.directions)
    for ray in range(4):
        for slot in range(3):
            point = int(neighbours[ray, slot])
            back = inputs["to_rest"][point]
            offset = inputs["origins"][ray] - inputs["positions"][point]
            turned = back @ inputs["directions"][ray]
            origin = inputs["rest"][point] + back @ offset
            torch.testing.assert_close(seen.origins[ray, slot], origin)
            torch.testing.assert_close(seen.directions[ray, slot], turned / turned.norm())


def side_by_side(front: float) -> dict[str, Tensor]:
    """Points 0 to 3 stay at depth 5; 4 to 7, far beside them at rest, were brought to `front`.

    The ray goes along z from the origin and passes points by 0.1, 0.2, 0.3 and 0.4.
    """
    beside = torch.tensor([0.1, 0.2, 0.3, 0.4]).repeat(2)
    depth = torch.tensor([5.0] * 4 + [front] * 4)
    positions = torch.stack([beside, torch.zeros(8), depth], dim=-1)
    rest = positions.clone()
    rest[4:, 0] += 10.0
    return {
        "origins": torch.zeros(1, 3),
        "directions": torch.tensor([[0.0, 0.0, 1.0]]),
        "positions": positions,
        "rest": rest,
        "to_rest": torch.eye(3).expand(8, 3, 3),
        "candidates": torch.arange(8).unsqueeze(0),
    }


@pytest.mark.parametrize("work", [cpu_pull_back, reference])
def test_the_foremost_and_its_like_come_first(work: ModuleType) -> None:
    """However near to the ray the points behind them are."""
    rules = (0.15, 1.0, 0.35)
    neighbours, _, _, has_back = work.pull_back(**side_by_side(3.0), k=3, layers=rules)
    assert neighbours.tolist() == [[4, 5, 6]]
    assert has_back.tolist() == [True]
    behind, _, counts, _ = work.pull_back(**side_by_side(3.0), k=3, layers=rules, back_layer=True)
    assert behind.tolist() == [[0, 1, 2]]
    assert counts.tolist() == [3]
    # The farthest of them is beyond the cut-off: of no layer behind, and no slot there is its.
    four, _, counts, _ = work.pull_back(**side_by_side(3.0), k=5, layers=rules, back_layer=True)
    assert counts.tolist() == [3]
    assert four.tolist() == [[0, 1, 2, 0, 0]], "empty slots repeat the nearest"
    # From the other side of the points that stayed they are themselves the foremost.
    assert work.pull_back(**side_by_side(7.0), k=3, layers=rules)[0].tolist() == [[0, 1, 2]]
    # What is behind the origin hides nothing; nothing is behind it either.
    neighbours, _, _, has_back = work.pull_back(**side_by_side(-1.0), k=3, layers=rules)
    assert neighbours.tolist() == [[0, 4, 1]]
    assert has_back.tolist() == [False]


@pytest.mark.parametrize("work", [cpu_pull_back, reference])
@pytest.mark.parametrize(
    "rules",
    [
        (0.05, 1.0, 0.35),  # No point is close.
        (0.15, 11.0, 0.35),  # All met the same rays at rest.
        None,
    ],
)
def test_where_nothing_tells_layers_apart_the_nearest_are_kept(
    work: ModuleType, rules: tuple[float, float, float] | None
) -> None:
    neighbours, _, _, has_back = work.pull_back(**side_by_side(3.0), k=4, layers=rules)
    assert neighbours.tolist() == [[0, 4, 1, 5]]
    assert has_back.tolist() == [False]


def test_neighbours_are_the_nearest_in_the_rest_state() -> None:
    inputs = scene(6, 30, 30)
    chosen = functional.pull_back(**inputs, k=4)[0]
    for ray in range(6):
        distances: list[float] = []
        for point in range(30):
            back = inputs["to_rest"][point]
            offset = back @ (inputs["origins"][ray] - inputs["positions"][point])
            along = back @ inputs["directions"][ray]
            distances.append(float(torch.linalg.cross(offset, along / along.norm()).norm()))
        assert chosen[ray].tolist() == torch.tensor(distances).argsort()[:4].tolist()


def test_pairs_with_rays_of_their_own_are_encoded_like_single_rays() -> None:
    positions = torch.randn(9, 3)
    neighbours = torch.randint(0, 9, (5, 3))
    origins = torch.randn(5, 3, 3)
    directions = torch.nn.functional.normalize(torch.randn(5, 3, 3), dim=-1)
    upstream = torch.randn(15, 6 * 8)
    for module in (reference, cpu):
        moving = positions.clone().requires_grad_()
        table, squared = module.encode_pairs(
            moving, origins, directions, neighbours, scale=3.0, frequencies=(1, 6)
        )
        single = positions.clone().requires_grad_()
        expected, expected_squared = module.encode_pairs(
            single,
            origins.reshape(-1, 3),
            directions.reshape(-1, 3),
            neighbours.reshape(-1, 1),
            scale=3.0,
            frequencies=(1, 6),
        )
        torch.testing.assert_close(table, expected)
        torch.testing.assert_close(squared, expected_squared.reshape(5, 3))
        gradients = [
            torch.autograd.grad((one * upstream).sum(), leaf)[0]
            for one, leaf in ((table, moving), (expected, single))
        ]
        torch.testing.assert_close(gradients[0], gradients[1], rtol=1e-4, atol=1e-3)
