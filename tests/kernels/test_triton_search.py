"""The Triton search without a GPU: interpreted against brute force, and compiled for real GPUs.

Both happen in processes of their own: whether Triton interprets is decided when it is imported.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.forked import Forked
from tests.kernels.triton_programs import run_triton

pytest.importorskip("triton", reason="triton is not installed (it exists for Linux only)")

_INTERPRETED = """
import torch
from pcore.kernels import cpu_search, triton_search

torch.manual_seed(0)
# The interpreter takes its time over every element.
triton_search.RAYS, triton_search.LANES = 2, 32
unit = torch.nn.functional.normalize
shapes = [(3, 123, 3), (1, 1, 1), (1, 130, 1), (3, 100, 20), (2, 9, 9), (1, 70, 64), (0, 5, 2)]
shapes += [(2, 20, 4)]
for rays, count, k in shapes:
    # Some anywhere, some on a grid, where many are equally far.
    grid = torch.randint(-1, 2, (count, 3)).float()
    points = torch.where(torch.rand(count, 1) < 0.5, torch.randn(count, 3), grid)
    origins, directions = torch.randn(rays, 3), unit(torch.randn(rays, 3), dim=-1)
    found = triton_search.nearest_to_rays(origins, directions, points, k)
    expected = cpu_search.nearest_to_rays(origins, directions, points, k)
    assert torch.equal(found, expected), (rays, count, k)
twice = [torch.stack([one, one], dim=-1)[..., 0] for one in (origins, directions, points)]
assert not twice[2].is_contiguous()
assert torch.equal(triton_search.nearest_to_rays(*twice, k), expected)
points[1] = float("nan")
found = triton_search.nearest_to_rays(origins, directions, points, count)
assert all(sorted(row) == list(range(count)) for row in found.tolist()), "all, each once"
"""

_COMPILED = """
import sys
from triton import compile
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource
from pcore.kernels import triton_search

capability = int(sys.argv[1])
signature = {
    "origins": "*fp32", "directions": "*fp32", "points": "*fp32", "out": "*i64",
    "rays": "i32", "count": "i32", "k": "i32",
    "RAYS": "constexpr", "LANES": "constexpr", "SLOTS": "constexpr",
}
for k in map(int, sys.argv[2:]):
    slots, lanes = triton_search.sizes(k)
    constants = {"RAYS": triton_search.RAYS, "LANES": lanes, "SLOTS": slots}
    compiled = compile(
        ASTSource(fn=triton_search.search, signature=signature, constexprs=constants),
        target=GPUTarget("cuda", capability, 32),
        options={"enable_fp_fusion": False},
    )
    assert f".target sm_{capability}" in compiled.asm["ptx"], k
    assert "fma.rn.f32" not in compiled.asm["ptx"], "rounds differently from the specification"
    assert len(compiled.asm["cubin"]) > 1000, k
"""


def test_interpreted_it_equals_the_search_on_the_cpu_bit_for_bit(
    tmp_path: Path, forked: Forked
) -> None:
    run_triton(forked, _INTERPRETED, folder=tmp_path, interpreted=True)


@pytest.mark.parametrize("capability", [pytest.param("80", marks=pytest.mark.slow), "90"])
def test_it_compiles_for_gpus_that_are_not_here(
    capability: str, tmp_path: Path, forked: Forked
) -> None:
    run_triton(forked, _COMPILED, capability, "8", "64", folder=tmp_path)
