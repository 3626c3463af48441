"""The Triton attention without a GPU: interpreted against the reference, compiled for real GPUs.

Both happen in processes of their own: whether Triton interprets is decided when it is imported.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from pcore.kernels import backends
from pcore.kernels.networks import Layers
from pcore.model.attention import ProximityAttention
from pcore.training.presets import preset

needs_triton = pytest.mark.skipif(
    not backends.has_triton(), reason="triton is not installed (it exists for Linux only)"
)

_INTERPRETED = """
import torch
from dataclasses import replace
from test_attention import RULES, attend, compare, double, scene
from pcore.kernels import functional, triton_attention as ours

single = "triton"
functional.of_attention = lambda positions, *_: (
    single if positions.dtype == torch.float32 else "reference"
)
cases = [
    ((7, 23, 5), {}),
    ((7, 23, 5), {"skip": 1, "slope": 0.2}),
    ((7, 23, 5), {"skip": 2}),
    ((11, 9, 4), {"each": True}),
    ((1, 1, 1), {}),
    ((50, 3, 1), {"feature": 1, "width": 33}),
    ((0, 4, 2), {}),
    ((3, 50, 40), {"width": 64}),
]
for index, (shape, form) in enumerate(cases):
    torch.manual_seed(index)
    inputs = scene(*shape, **form)
    # Gradients in chunks of a few rays.
    ours._RECOMPUTED_BYTES = 2**30 if index % 2 else 50_000
    compare(attend(inputs, RULES), attend(double(inputs), RULES))
strided = attend(inputs, RULES, lambda one: torch.stack([one, one], dim=-1)[..., 0])
compare(strided, attend(double(inputs), RULES))
compare(*(attend(one, replace(RULES, cutoff=None)) for one in (inputs, double(inputs))))
out, gradients = attend(inputs, replace(RULES, cutoff=1e-6))
assert float(out.background.min()) == 1 and float(out.features.abs().max()) == 0
assert all(float(one.abs().max()) == 0 for one in gradients)

# Networks of all depths: an odd and an even number of layers before the last one.
from test_attention import OWN, WAVES, network
for layers in (2, 3, 4, 5):
    inputs["key"] = network(OWN + WAVES, layers, 20, 7)
    inputs["value"] = network(WAVES + 5, layers, 20, 4, skip=layers - 1)
    compare(attend(inputs, RULES), attend(double(inputs), RULES))

# With a threshold the value network sees the pairs that are kept and no others.
launch, seen = ours.launch_features, []

def launch_counted(packed, waves, features, neighbours, weights):
    seen.append(neighbours.numel())
    return launch(packed, waves, features, neighbours, weights)

ours.launch_features = launch_counted
for shape in ((14, 30, 6), (1, 9, 4), (0, 4, 2)):
    some, fast = scene(*shape), replace(RULES, threshold=0.03)
    for rules in (fast, replace(fast, threshold=0.3), replace(fast, cutoff=1e-6)):
        before = len(seen)
        found = attend(some, rules)
        compare(found, attend(double(some), rules))
        kept = int((functional.cut(found[0].weights, rules.threshold) != 0).sum())
        assert seen[before:] == [kept], (shape, seen[before:], kept)
        assert kept < int((found[0].weights > 0).sum()) or rules.threshold < 0.1 or shape[0] < 2

# float16: the interpreter has no product of bfloat16.
exact, exact_gradients = attend(double(inputs), RULES)
with torch.autocast("cpu", dtype=torch.float16):
    rough, gradients = attend(inputs, RULES)
assert 0 < float((rough.background - exact.background).abs().max()) < 1e-3
assert 0 < float((rough.features - exact.features).abs().max()) < 1e-2
for one, other in zip(gradients, exact_gradients, strict=True):
    assert one.dtype == torch.float32
    assert float((one - other).norm()) <= 0.02 * float(other.norm()), one.shape
"""

_KINDS = ("fp32", "bf16")

_COMPILED = """
import sys
import torch
from triton import compile
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource
from pcore.kernels import triton_attention, triton_pairs
from pcore.kernels.networks import EPSILON
from pcore.kernels.triton_networks import launch_options, shape_of
from pcore.model.attention import ProximityAttention
from pcore.model.encoding import encoded_size
from pcore.training.presets import preset

capability = int(sys.argv[1])

def check(name, kind):
    config = preset(name).model
    attention = ProximityAttention(config)
    dtype = getattr(torch, {"fp32": "float32", "bf16": "bfloat16"}[kind])
    own, along, across = (
        encoded_size(3, octaves)
        for octaves in (config.octaves.point, config.octaves.along, config.octaves.across)
    )
    waves = along + across
    shape_of_keys = shape_of(attention.key.mlp.stack(), own, waves, dtype)
    hidden = triton_attention.all_but_last(attention.value.stack())
    shape_of_values = shape_of(hidden, waves, config.feature_size, dtype, config.neighbours)
    kernels = [
        (triton_pairs.pair_scores, {
            "own": "*fp32", "waves": "*fp32", "points": "*i64", "answering": "*u1",
            "queries": "*fp32", "weights": "*" + kind, "biases": "*fp32", "out": "*fp32",
            "pairs": "i32", "neighbours": "i32", "SHAPE": "constexpr", "EPSILON": "constexpr",
        }, {"SHAPE": shape_of_keys, "EPSILON": EPSILON}),
        (triton_pairs.pooled_values, {
            "waves": "*fp32", "features": "*fp32", "points": "*i64", "shares": "*fp32",
            "weights": "*" + kind, "biases": "*fp32", "out": "*fp32",
            "rays": "i32", "neighbours": "i32", "SHAPE": "constexpr", "RAYS": "constexpr",
        }, {
            "SHAPE": shape_of_values,
            "RAYS": triton_pairs.sum_rows(shape_of_values, config.neighbours),
        }),
    ]
    for kernel, signature, constants in kernels:
        aligned = {
            (index,): [["tt.divisibility", 16]]
            for index, one in enumerate(signature.values()) if one.startswith("*")
        }
        compiled = compile(
            ASTSource(fn=kernel, signature=signature, constexprs=constants, attrs=aligned),
            target=GPUTarget("cuda", capability, 32),
            options=launch_options(constants["SHAPE"]),
        )
        ptx = compiled.asm["ptx"]
        assert f".target sm_{capability}" in ptx
        assert len(compiled.asm["cubin"]) > 1000
        assert "tf32" not in ptx, "float32 is to stay float32"
        assert ("mma" in ptx) == (kind == "bf16"), "half precision is for tensor cores"
        # What a block may have on GPUs from sm_80 on, sm_86 and sm_89 included.
        assert compiled.metadata.shared <= 99 * 1024, compiled.metadata.shared

for one in sys.argv[2:]:
    try:
        check(*one.split("/"))
    except Exception as problem:
        raise RuntimeError(f"{one} does not compile as it should") from problem
"""


def run(*arguments: str, cache: Path, **environment: str) -> None:
    shown = subprocess.run(
        [sys.executable, *arguments],
        env=os.environ | {"TRITON_CACHE_DIR": str(cache)} | environment,
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert shown.returncode == 0, shown.stdout + shown.stderr


@needs_triton
def test_interpreted_it_gives_what_the_reference_gives(tmp_path: Path) -> None:
    """Values and gradients of the cases of test_attention, and under autocast."""
    run("-c", _INTERPRETED, cache=tmp_path, TRITON_INTERPRET="1")


@needs_triton
@pytest.mark.timeout(600)
@pytest.mark.parametrize("capability", [pytest.param("80", marks=pytest.mark.slow), "90"])
@pytest.mark.slow  # 28 s; interpreted it is tested always.
def test_it_compiles_for_gpus_that_are_not_here(capability: str, tmp_path: Path) -> None:
    """One process for all presets: it is torch and Triton that take their time to be imported."""
    others = [f"{name}/{kind}" for name in ("fast", "paper", "paper-lego") for kind in _KINDS]
    run("-c", _COMPILED, capability, "tiny/fp32", *others, cache=tmp_path)


def _networks(width: int) -> tuple[Layers, Layers]:
    weights = (torch.zeros(width, 8), torch.zeros(8, width))
    network = Layers(weights=weights, biases=(torch.zeros(width), torch.zeros(8)))
    return network, network


def test_what_triton_does_not_take_the_reference_serves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backends, "backend", lambda device: "triton")
    single, double = torch.zeros(4, 3), torch.zeros(4, 3, dtype=torch.float64)
    assert backends.of_attention(single, *_networks(256), 20) == "triton"
    assert backends.of_attention(single, *_networks(257), 20) == "reference"
    assert backends.of_attention(single, *_networks(256), 129) == "reference"
    assert backends.of_attention(double, *_networks(256), 20) == "reference"
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert backends.of_attention(single, *_networks(256), 20) == "triton"
    key, value = _networks(64)
    # The last layer of the values is applied outside the kernel: it may be as wide as it likes.
    wide = replace(
        value,
        weights=(value.weights[0], torch.zeros(300, 64)),
        biases=(value.biases[0], torch.zeros(300)),
    )
    assert backends.of_attention(single, key, wide, 20) == "triton"


@pytest.mark.parametrize("name", ["tiny", "fast", "paper", "paper-lego"])
def test_triton_takes_all_presets(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backends, "backend", lambda device: "triton")
    config = preset(name).model  # pyright: ignore[reportArgumentType]
    attention = ProximityAttention(config)
    key, value = attention.key.mlp.stack(), attention.value.stack()
    assert backends.of_attention(torch.zeros(1, 3), key, value, config.neighbours) == "triton"
