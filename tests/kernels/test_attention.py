"""Proximity attention: the CPU kernels against the reference in float64, values and gradients."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest
import torch
from torch import Tensor

from pcore.kernels import cpu_networks, functional
from pcore.kernels.functional import AttentionRules
from pcore.kernels.networks import Layers, standardise

LEAVES = ("positions", "features", "influence", "queries", "constants")
RULES = AttentionRules(
    scale=2.0, frequencies=(3, 1, 4), background_score=0.5, cutoff=1.0, stop_encoding=True
)
OWN, WAVES = 3 * (1 + 2 * 3), 3 * (1 + 2 * 1) + 3 * (1 + 2 * 4)
TOLERANCE = 1e-5


@dataclass(frozen=True)
class Attention:
    """What `proximity_attention` returns, by name."""

    features: Tensor
    background: Tensor
    weights: Tensor
    answering: Tensor


def proximity_attention(**inputs: Any) -> Attention:
    return Attention(*functional.proximity_attention(**inputs))


def network(
    size_in: int, layers: int, width: int, size: int, *, slope: float = 0.0, skip: int | None = None
) -> Layers:
    widths = [width] * (layers - 1) + [size]
    sizes_in = [size_in, *widths[:-1]]
    if skip is not None:
        sizes_in[skip] += size_in
    return Layers(
        weights=tuple(
            torch.randn(out, into) * (2 / into) ** 0.5
            for out, into in zip(widths, sizes_in, strict=True)
        ),
        biases=tuple(0.1 * torch.randn(out) for out in widths),
        negative_slope=slope,
        skip_after=skip,
    )


def scene(
    rays: int,
    points: int,
    k: int,
    *,
    feature: int = 5,
    width: int = 12,
    each: bool = False,
    **form: Any,
) -> dict[str, Any]:
    """Random inputs; `each` gives every pair a ray of its own; `form` is the networks'."""
    shape = (rays, k, 3) if each else (rays, 3)
    return {
        "positions": torch.randn(points, 3) * 0.5,
        "features": torch.randn(points, feature),
        "influence": torch.rand(points) + 0.5,
        "origins": torch.randn(shape),
        "directions": torch.nn.functional.normalize(torch.randn(shape), dim=-1),
        "neighbours": torch.randint(0, points, (rays, k)),
        "queries": torch.randn(rays, 7) * 0.5,
        "constants": torch.randn(rays) * 0.5,
        "key": network(OWN + WAVES, 3, width, 7, **form),
        "value": network(WAVES + feature, 3, width, 4, **form),
    }


def double(inputs: dict[str, Any]) -> dict[str, Any]:
    def change(value: Any) -> Any:
        if isinstance(value, Layers):
            return replace(
                value,
                weights=tuple(one.double() for one in value.weights),
                biases=tuple(one.double() for one in value.biases),
            )
        return value.double() if value.is_floating_point() else value

    return {name: change(value) for name, value in inputs.items()}


def attend(
    inputs: dict[str, Any], rules: AttentionRules, change: Callable[[Tensor], Tensor] | None = None
) -> tuple[Attention, list[Tensor]]:
    """Results, and the gradients of everything for random cotangents."""
    inputs = {k: v.detach().clone() if isinstance(v, Tensor) else v for k, v in inputs.items()}
    for name in ("key", "value"):
        layers: Layers = inputs[name]
        inputs[name] = replace(
            layers,
            weights=tuple(one.detach().clone().requires_grad_() for one in layers.weights),
            biases=tuple(one.detach().clone().requires_grad_() for one in layers.biases),
        )
    leaves = [inputs[name].requires_grad_() for name in LEAVES]
    for name in ("key", "value"):
        leaves += [*inputs[name].weights, *inputs[name].biases]
    given = {k: change(v) if change and isinstance(v, Tensor) else v for k, v in inputs.items()}
    out = proximity_attention(**given, rules=rules)
    generator = torch.Generator().manual_seed(5)
    loss = torch.zeros((), dtype=out.features.dtype)
    for result in (out.features, out.background, out.weights):
        cotangent = torch.randn(result.shape, generator=generator)
        loss = loss + (result * cotangent.to(result.dtype)).sum()
    gradients = torch.autograd.grad(loss, leaves, allow_unused=True, materialize_grads=True)
    return Attention(**{k: v.detach() for k, v in vars(out).items()}), list(gradients)


def compare(
    found: tuple[Attention, list[Tensor]], expected: tuple[Attention, list[Tensor]]
) -> None:
    values = zip(*(vars(one[0]).values() for one in (found, expected)), strict=True)
    for one, other in [*values, *zip(found[1], expected[1], strict=True)]:
        largest = max(1e-3, float(other.double().abs().max())) if other.numel() else 0.0
        difference = (one.double() - other.double()).abs()
        assert one.shape == other.shape
        assert not one.numel() or float(difference.max()) <= TOLERANCE * largest


@pytest.mark.parametrize(
    ("shape", "form"),
    [
        ((37, 123, 5), {}),
        ((37, 123, 5), {"slope": 0.2}),
        ((37, 123, 5), {"skip": 1}),
        ((37, 123, 5), {"skip": 2, "slope": 0.2}),
        ((41, 9, 4), {"each": True}),
        ((1, 1, 1), {}),
        ((50, 3, 1), {"feature": 1, "width": 33}),
        ((0, 4, 2), {}),
        ((300, 20, 8), {"width": 64}),
    ],
)
def test_the_cpu_gives_what_the_reference_gives(
    shape: tuple[int, int, int], form: dict[str, Any]
) -> None:
    inputs = scene(*shape, **form)
    compare(attend(inputs, RULES), attend(double(inputs), RULES))


@pytest.fixture
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cpu_networks, "_CHUNK_BYTES", 4 * 12 * 40)


@pytest.mark.usefixtures("small_chunks")
@pytest.mark.parametrize("kept", [0, 20_000, 2**30])
def test_chunks_and_what_they_keep_change_nothing(
    kept: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing kept, something, everything; with more neighbours than fit a chunk, too."""
    monkeypatch.setattr(cpu_networks, "_KEPT_BYTES", kept)
    for shape in ((101, 60, 7), (5, 60, 55)):
        inputs = scene(*shape, skip=1)
        compare(attend(inputs, RULES), attend(double(inputs), RULES))


def test_equal_points() -> None:
    inputs = scene(20, 6, 4)
    inputs["positions"] = inputs["positions"][:1].expand(6, 3)
    inputs["neighbours"] = torch.arange(4).expand(20, 4)
    compare(attend(inputs, RULES), attend(double(inputs), RULES))


def test_without_a_cutoff_all_answer() -> None:
    inputs, rules = scene(20, 30, 4), replace(RULES, cutoff=None)
    found = attend(inputs, rules)
    assert bool(found[0].answering.all())
    compare(found, attend(double(inputs), rules))


def test_rays_that_no_point_answers_are_background() -> None:
    inputs, rules = scene(20, 30, 4), replace(RULES, cutoff=1e-6)
    out, gradients = attend(inputs, rules)
    assert not bool(out.answering.any())
    assert torch.equal(out.background, torch.ones(20))
    assert float(out.weights.abs().max()) == float(out.features.abs().max()) == 0
    assert all(float(one.abs().max()) == 0 for one in gradients)


def test_pairs_beyond_the_cutoff_and_without_score_are_not_computed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The rows that enter the networks are counted: it is what the kernels are for."""
    rows: list[int] = []
    forward, backward = cpu_networks.Network.forward, cpu_networks.Network.backward

    def counted_forward(self: Any, x: Tensor) -> list[Tensor]:
        rows.append(len(x))
        return forward(self, x)

    def counted_backward(self: Any, gradient: Tensor, *others: Any) -> Tensor:
        rows.append(len(gradient))
        return backward(self, gradient, *others)

    monkeypatch.setattr(cpu_networks.Network, "forward", counted_forward)
    monkeypatch.setattr(cpu_networks.Network, "backward", counted_backward)
    out, _ = attend(scene(200, 90, 4), RULES)
    answering = int(out.answering.sum())
    key, value, value_back, key_back = rows
    assert key == answering < 800
    assert value == value_back == int((out.weights > 0).sum())
    assert 0 < key_back < answering


@pytest.mark.parametrize("name", ["reference", "cpu"])
def test_a_threshold_leaves_out_small_weights(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PCORE_KERNELS", name)
    inputs = scene(50, 40, 6)
    exact = proximity_attention(**inputs, rules=RULES)
    fast = proximity_attention(**inputs, rules=replace(RULES, threshold=0.2))
    assert torch.equal(fast.weights, exact.weights)
    assert torch.equal(fast.background, exact.background)
    kept = exact.weights.where(exact.weights >= 0.2, 0.0)
    assert bool((kept.sum(dim=-1) < exact.weights.sum(dim=-1)).any())
    kept = kept / kept.sum(dim=-1, keepdim=True).clamp_min(1e-30)
    by_hand = functional.reference_attention.attention_features(
        functional.encode_pairs(
            *(inputs[key] for key in ("positions", "origins", "directions", "neighbours")),
            scale=RULES.scale,
            frequencies=RULES.frequencies[1:],
        )[0],
        inputs["features"],
        inputs["neighbours"],
        kept,
        inputs["value"],
    )
    expected = inputs["value"].last(by_hand) * (kept.sum(dim=-1, keepdim=True) > 0)
    torch.testing.assert_close(fast.features, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("shape", [(50, 40, 6), (1, 9, 4), (0, 4, 2)])
@pytest.mark.parametrize("cutoff", [RULES.cutoff, 1e-6])
def test_the_value_network_of_the_reference_sees_the_kept_pairs_alone(
    shape: tuple[int, int, int], cutoff: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their number is counted; values and gradients are those of the CPU kernels."""
    inputs, rules = scene(*shape), replace(RULES, threshold=0.2, cutoff=cutoff)
    expected, rows = attend(inputs, rules), []
    hidden = Layers.hidden

    def counted(self: Layers, x: Tensor) -> Tensor:
        if len(self.biases[-1]) == len(inputs["value"].biases[-1]):
            rows.append(x.shape[:-1].numel())
        return hidden(self, x)

    monkeypatch.setattr(Layers, "hidden", counted)
    monkeypatch.setenv("PCORE_KERNELS", "reference")
    found = attend(inputs, rules)
    compare(found, expected)
    kept = int((functional.cut(found[0].weights, 0.2) != 0).sum())
    assert rows == [kept]
    assert kept < int((found[0].weights > 0).sum()) or shape[0] < 2 or cutoff == 1e-6


def test_a_threshold_above_all_weights_leaves_the_greatest() -> None:
    inputs = scene(50, 40, 6)
    inputs["constants"] += 5  # No score is cut to zero, so there are no ties.
    out = proximity_attention(**inputs, rules=replace(RULES, threshold=0.99))
    one = inputs | {
        "neighbours": inputs["neighbours"].gather(1, out.weights.argmax(dim=1, keepdim=True))
    }
    torch.testing.assert_close(
        out.features, proximity_attention(**one, rules=RULES).features, rtol=1e-4, atol=1e-5
    )


@pytest.mark.parametrize("rays", [1, 4, 60])
def test_few_rays_encode_their_own_points_alone(rays: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 200 points, without gradient; what comes out is what rays of a large call get."""
    encoded: list[int] = []
    whole = functional.reference.encode

    def count(x: Tensor, frequencies: int) -> Tensor:
        encoded.append(len(x))
        return whole(x, frequencies)

    inputs = scene(rays, 200, 4)
    with_gradient = attend(inputs, RULES)[0]
    monkeypatch.setattr(functional.reference, "encode", count)
    with torch.no_grad():
        found = proximity_attention(**inputs, rules=RULES)
    few = len(inputs["neighbours"].unique())
    assert encoded == [few if rays < 50 else 200]
    compare((found, []), (with_gradient, []))
    encoded.clear()
    proximity_attention(**inputs, rules=RULES)
    assert encoded == [200], "a training does not wait to know which points are asked for"


def test_strided_inputs() -> None:
    inputs = scene(30, 20, 4)
    strided = attend(inputs, RULES, lambda one: torch.stack([one, one], dim=-1)[..., 0])
    compare(strided, attend(double(inputs), RULES))


def test_other_types_and_autocast_take_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> Tensor:
        raise AssertionError("the CPU kernels know neither")

    monkeypatch.setattr(functional.cpu_attention, "attention_scores", refuse)
    inputs = scene(10, 20, 4)
    assert proximity_attention(**double(inputs), rules=RULES).features.dtype == torch.float64
    with torch.autocast("cpu", dtype=torch.bfloat16):
        rough = proximity_attention(**inputs, rules=RULES)
    exact = proximity_attention(**double(inputs), rules=RULES)
    assert float((rough.background - exact.background).abs().max()) < 0.1


def test_nothing_is_kept_without_gradient_and_what_is_kept_is_bounded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Bytes that a forward pass holds on to, counted by what autograd saves."""
    monkeypatch.setattr(cpu_networks, "_KEPT_BYTES", 200_000)
    inputs = scene(400, 50, 8, width=64)
    saved: list[int] = []

    def pack(tensor: Tensor) -> Tensor:
        saved.append(4 * tensor.numel())
        return tensor

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda tensor: tensor), torch.no_grad():
        proximity_attention(**inputs, rules=RULES)
    assert saved == []
    inputs["positions"].requires_grad_()
    with torch.autograd.graph.saved_tensors_hooks(pack, lambda tensor: tensor):
        proximity_attention(**inputs, rules=RULES)
    # Twice what may be kept, and what grows with the pairs but not with the networks' width.
    table = 4 * 400 * 8 * (WAVES + 10)
    assert sum(saved) < 2 * 200_000 + 3 * table


@pytest.mark.parametrize("each", [True, False])
def test_gradients_of_rays_and_encoded_positions(each: bool) -> None:
    """Which training leaves out; in float32 by the kernels as far as they know them."""
    inputs, rules = scene(20, 30, 4, each=each), replace(RULES, stop_encoding=False, cutoff=None)
    leaves = ("positions", "origins", "directions", "queries")

    def gradients_of(given: dict[str, Any]) -> list[Tensor]:
        given = given | {name: given[name].clone().requires_grad_() for name in leaves}
        out = proximity_attention(**given, rules=rules)
        loss = out.features.square().sum() + out.background.square().sum()
        return list(torch.autograd.grad(loss, [given[name] for name in leaves]))

    exact = double(inputs)
    expected = gradients_of(exact)
    for one, other in zip(gradients_of(inputs), expected, strict=True):
        largest = float(other.abs().max())
        torch.testing.assert_close(one.double(), other, rtol=0, atol=1e-3 * largest)
    step = 1e-6
    for name, gradient in zip(leaves, expected, strict=True):
        change = torch.randn(exact[name].shape, dtype=torch.float64)
        losses: list[float] = []
        for sign in (-1, 1):
            out = proximity_attention(
                **(exact | {name: exact[name] + sign * step * change}), rules=rules
            )
            losses.append(float(out.features.square().sum() + out.background.square().sum()))
        slope = (losses[1] - losses[0]) / (2 * step)
        assert float((gradient * change).sum()) == pytest.approx(slope, rel=1e-4, abs=1e-6), name


@pytest.mark.parametrize("each", [True, False])
def test_origins_alone_keep_the_kernels(each: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rays of posed points in a training: offsets are encoded by the kernel as points are."""
    inputs = scene(20, 30, 4, each=each)
    names = ("positions", "origins", "directions", "neighbours")
    given = {name: inputs[name] for name in names}
    expected, _ = functional.encode_pairs(**given, scale=2.0, frequencies=(1, 4))
    monkeypatch.setattr(functional.reference, "encode_pairs", None)
    given["origins"] = inputs["origins"].clone().requires_grad_()
    given["positions"] = inputs["positions"].clone().requires_grad_()
    found, _ = functional.encode_pairs(**given, scale=2.0, frequencies=(1, 4))
    torch.testing.assert_close(found, expected)
    to_origins, to_positions = torch.autograd.grad(
        found.square().sum(), (given["origins"], given["positions"])
    )
    torch.testing.assert_close(
        to_origins.reshape(-1, 3).sum(dim=0), -to_positions.sum(dim=0), rtol=1e-3, atol=1e-3
    )


# --- the networks --------------------------------------------------------------------------


@pytest.mark.parametrize("skip", [None, 1, 2])
def test_a_gain_and_an_offset_before_a_network_are_part_of_it(skip: int | None) -> None:
    layers = network(6, 3, 8, 5, slope=0.1, skip=skip)
    x, gain, offset = torch.randn(4, 6), torch.randn(6), torch.randn(6)
    folded = layers.after(gain, offset)
    torch.testing.assert_close(folded(x), layers(gain * x + offset), rtol=1e-4, atol=1e-5)


def test_standardised_rows() -> None:
    x = standardise(torch.randn(3, 50) * 4 + 2)
    torch.testing.assert_close(x.mean(dim=-1), torch.zeros(3), rtol=0, atol=1e-5)
    torch.testing.assert_close(x.square().mean(dim=-1), torch.ones(3), rtol=0, atol=1e-5)
