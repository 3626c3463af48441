"""Which Gaussians come and go."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from pcore.gaussians.covariance import covariances
from pcore.training.gaussian_config import DensityConfig
from pcore.training.gaussian_density import Change, changes

CONFIG = DensityConfig(limit=1000)
DISTANCE = 4.0


def raw(count: int, *, scale: float = 0.01, opacity: float = 0.5) -> dict[str, Tensor]:
    return {
        "means": torch.randn(count, 3),
        "scales": torch.full((count, 3), scale).log(),
        "quats": torch.randn(count, 4),
        "opacities": torch.full((count,), opacity).logit(),
        "colors": torch.randn(count, 1, 3),
    }


def decided(rows: dict[str, Tensor], gradients: Tensor, config: DensityConfig = CONFIG) -> Change:
    draw = torch.Generator().manual_seed(0)
    return changes(rows, gradients, config, DISTANCE, masked=True, generator=draw)


def test_small_ones_that_are_pulled_are_copied() -> None:
    rows = raw(4)
    change = decided(rows, torch.tensor([0.0, 1.0, 0.0, 1.0]))
    assert change.keep.all()
    for name, tensor in rows.items():
        assert torch.equal(change.new[name], tensor[[1, 3]])


def test_large_ones_become_two_smaller_ones_within_them() -> None:
    count = 4000
    rows = raw(count)
    rows["scales"] = torch.tensor([0.3, 0.1, 0.05]).log().expand(count, 3)
    rows["means"], rows["quats"] = torch.zeros(count, 3), torch.randn(1, 4).expand(count, 4)
    change = decided(rows, torch.ones(count), replace(CONFIG, limit=10**6))
    assert not change.keep.any()
    assert len(change.new["means"]) == 2 * count
    torch.testing.assert_close(change.new["scales"].exp()[0], torch.tensor([0.3, 0.1, 0.05]) / 1.6)
    quats = torch.nn.functional.normalize(rows["quats"][:1], dim=-1)
    truth = covariances(quats, torch.tensor([[0.3, 0.1, 0.05]]))[0]
    torch.testing.assert_close(change.new["means"].T.cov(), truth, rtol=0.1, atol=3e-3)


def test_faint_and_huge_ones_go_even_when_they_are_pulled() -> None:
    rows = raw(3)
    rows["opacities"][0] = torch.tensor(0.004).logit()
    rows["scales"][1] = torch.tensor(0.5).log()
    change = decided(rows, torch.ones(3))
    assert change.keep.tolist() == [False, False, True]
    assert len(change.new["means"]) == 1


def test_without_masks_the_huge_ones_stay() -> None:
    rows = raw(1, scale=0.5)
    draw = torch.Generator().manual_seed(0)
    change = changes(rows, torch.zeros(1), CONFIG, DISTANCE, masked=False, generator=draw)
    assert change.keep.all()


def test_the_limit_holds_and_the_most_pulled_come_first() -> None:
    rows, gradients = raw(100), torch.arange(100.0)
    change = decided(rows, gradients, replace(CONFIG, limit=110))
    assert torch.equal(change.new["means"], rows["means"][90:])
    assert len(decided(rows, gradients, replace(CONFIG, limit=50)).new["means"]) == 0
