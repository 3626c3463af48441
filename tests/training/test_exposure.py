"""Exposure of every photo: learned along, fitted for figures, saved."""

from __future__ import annotations

import copy

import pytest
import torch

from pcore.errors import CheckpointError
from pcore.training.exposure import ViewExposure, fitted_exposure

CPU = torch.device("cpu")


def test_it_learns_the_gain_of_every_photo_but_for_the_mean_of_all() -> None:
    generator = torch.Generator().manual_seed(0)
    true = torch.rand(60, 3, generator=generator)
    gains, alpha, white = (0.8, 1.0, 1.2), torch.ones(60), torch.ones(3)
    exposure = ViewExposure(3, CPU)
    for step in range(900):
        view = step % 3
        shown = exposure.applied(view, true, alpha, white)
        (shown - gains[view] * true).square().mean().backward()
        exposure.step(step / 900)
    for view, gain in enumerate(gains):
        found = exposure.maps()[view]
        shown = true @ found[:, :3].T + found[:, 3]
        torch.testing.assert_close(shown, gain * true, atol=0.02, rtol=0)
    identity = torch.cat([torch.eye(3), torch.zeros(3, 1)], dim=1)
    torch.testing.assert_close(exposure.maps().mean(dim=0), identity)


def test_the_background_is_not_exposed() -> None:
    exposure = ViewExposure(2, CPU)
    with torch.no_grad():
        exposure.change[0, :, 3] = 0.5
    black = torch.zeros(3)
    clear, solid = torch.tensor([0.0]), torch.tensor([1.0])
    rgb = torch.full((1, 3), 0.2)
    assert torch.equal(exposure.applied(0, black.expand(1, 3), clear, black), torch.zeros(1, 3))
    torch.testing.assert_close(exposure.applied(0, rgb, solid, black), rgb + 0.25)


def test_a_state_goes_on_exactly() -> None:
    first, second = ViewExposure(2, CPU), ViewExposure(2, CPU)
    rgb = torch.rand(5, 3, generator=torch.Generator().manual_seed(1))

    def step(exposure: ViewExposure) -> None:
        exposure.applied(1, rgb, torch.ones(5), torch.ones(3)).square().mean().backward()
        exposure.step(0.5)

    step(first)
    second.restore(copy.deepcopy(first.state()))
    step(first)
    step(second)
    assert torch.equal(first.change, second.change)
    with pytest.raises(CheckpointError, match="exposure of 3 views, got 2"):
        ViewExposure(3, CPU).restore(first.state())
    with pytest.raises(CheckpointError, match="got none"):
        ViewExposure(3, CPU).restore({})


def test_a_fitted_map_undoes_exposure_and_nothing_else() -> None:
    generator = torch.Generator().manual_seed(2)
    rgb = torch.rand(200, 3, generator=generator)
    warmer = rgb @ torch.tensor([[1.2, 0, 0.05], [0, 1.0, 0], [0, 0, 0.7]]) + 0.1
    torch.testing.assert_close(fitted_exposure(rgb, warmer), warmer, atol=1e-4, rtol=0)
    other = torch.rand(200, 3, generator=generator)
    assert float((fitted_exposure(rgb, other) - other).square().mean()) > 0.05
    flat = torch.full((50, 3), 0.4)
    torch.testing.assert_close(fitted_exposure(flat, flat), flat, atol=1e-3, rtol=0)
