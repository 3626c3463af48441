"""Rays of the rest state: the fast backend against the reference, the reference against the
formulas."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from pcore.kernels import cpu, functional, reference


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


@pytest.mark.parametrize(
    ("rays", "points", "candidates", "k"),
    [(37, 123, 11, 5), (1, 1, 1, 1), (0, 9, 4, 2), (5, 8, 8, 8)],
)
def test_backends_agree(rays: int, points: int, candidates: int, k: int) -> None:
    inputs = scene(rays, points, candidates)
    expected = reference.pull_back(**inputs, k=k)
    found = cpu.pull_back(**inputs, k=k)
    assert torch.equal(found[0], expected[0])
    torch.testing.assert_close(found[1:], expected[1:], rtol=1e-4, atol=1e-4)


def test_a_pair_sees_the_ray_through_its_own_map() -> None:
    inputs = scene(4, 20, 7)
    chosen, origins, directions = functional.pull_back(**inputs, k=3)
    for ray in range(4):
        for slot in range(3):
            point = int(chosen[ray, slot])
            back = inputs["to_rest"][point]
            offset = inputs["origins"][ray] - inputs["positions"][point]
            turned = back @ inputs["directions"][ray]
            torch.testing.assert_close(origins[ray, slot], inputs["rest"][point] + back @ offset)
            torch.testing.assert_close(directions[ray, slot], turned / turned.norm())


def test_neighbours_are_the_nearest_in_the_rest_state() -> None:
    inputs = scene(6, 30, 30)
    chosen, _, _ = functional.pull_back(**inputs, k=4)
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
