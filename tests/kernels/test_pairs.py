"""Encoding of ray-point pairs: the fast backend against the reference, the reference against the
formulas and against numeric gradients."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from pcore.kernels import cpu, functional, reference

SCALE, FREQUENCIES = 10.0, (4, 6)


def scene(rays: int, points: int, k: int) -> dict[str, Tensor]:
    return {
        "positions": torch.randn(points, 3) * 0.5,
        "origins": torch.randn(rays, 3) * 2,
        "directions": torch.nn.functional.normalize(torch.randn(rays, 3), dim=-1),
        "neighbours": torch.randint(0, points, (rays, k)),
    }


@pytest.mark.parametrize("shape", [(5, 123, 3), (1, 1, 1), (70, 40, 20), (0, 4, 2)])
@pytest.mark.parametrize("frequencies", [FREQUENCIES, (0, 4), (2, 0)])
def test_backends_agree_in_values_and_gradients(
    shape: tuple[int, int, int], frequencies: tuple[int, int]
) -> None:
    inputs = scene(*shape)
    upstream = torch.randn(shape[0] * shape[2], 6 * (1 + sum(frequencies)))
    results: list[list[Tensor]] = []
    for module in (reference, cpu):
        positions = inputs["positions"].clone().requires_grad_()
        waves, squared = module.encode_pairs(
            **(inputs | {"positions": positions}), scale=SCALE, frequencies=frequencies
        )
        assert not squared.requires_grad
        (gradient,) = torch.autograd.grad(
            (waves * upstream).sum(), positions, materialize_grads=True
        )
        results.append([waves.detach(), squared, gradient])
    for expected, found in zip(*results, strict=True):
        # Relative to the largest entry: phases reach 32 * 10 * 6 radians in float32.
        largest = float(expected.abs().max()) if expected.numel() else 0.0
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-4 * largest)


@pytest.mark.parametrize("frequencies", [FREQUENCIES, (0, 3)])
def test_rows_are_the_formulas(frequencies: tuple[int, int]) -> None:
    inputs = scene(3, 5, 2)
    waves, squared = functional.encode_pairs(**inputs, scale=2.0, frequencies=frequencies)
    ray, slot = 1, 1
    point = inputs["neighbours"][ray, slot]
    p, o, d = inputs["positions"][point], inputs["origins"][ray], inputs["directions"][ray]
    h = torch.dot(p - o, d) * d
    t = (p - o) - h
    row = waves[ray * 2 + slot]
    start = 0
    for vector, octaves in zip((h, t), frequencies, strict=True):
        for axis in range(3):
            x = (2.0 if octaves else 1.0) * float(vector[axis])
            expected = [x, *(f(2**o * x) for o in range(octaves) for f in (math.sin, math.cos))]
            found = row[start : start + len(expected)]
            assert found.tolist() == pytest.approx(expected, abs=1e-3)
            start += len(expected)
    assert start == len(row)
    assert float(squared[ray, slot]) == pytest.approx(float(t.square().sum()), rel=1e-4)


def test_numeric_gradients_of_the_reference() -> None:
    inputs = {
        name: value.double() if value.is_floating_point() else value
        for name, value in scene(3, 4, 2).items()
    }

    def trainable(positions: Tensor) -> Tensor:
        moved = inputs | {"positions": positions}
        return reference.encode_pairs(**moved, scale=3.0, frequencies=(0, 2))[0]

    assert torch.autograd.gradcheck(trainable, [inputs["positions"].requires_grad_()])


def test_strided_inputs() -> None:
    inputs = scene(6, 8, 2)
    strided = {name: torch.stack([v, v], dim=-1)[..., 0] for name, v in inputs.items()}
    assert not strided["positions"].is_contiguous()
    expected, _ = cpu.encode_pairs(**inputs, scale=SCALE, frequencies=FREQUENCIES)
    found, _ = cpu.encode_pairs(**strided, scale=SCALE, frequencies=FREQUENCIES)
    assert torch.equal(found, expected)
