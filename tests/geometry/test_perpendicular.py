"""A direction across a direction."""

from __future__ import annotations

import torch

from pcore.geometry.rays import perpendicular


def test_it_is_of_unit_length_and_at_right_angles_also_to_axes() -> None:
    directions = torch.cat([torch.randn(200, 3), torch.eye(3), -torch.eye(3)])
    directions = torch.nn.functional.normalize(directions, dim=1)
    found = perpendicular(directions)
    torch.testing.assert_close(found.norm(dim=1), torch.ones(206))
    assert float((found * directions).sum(dim=1).abs().max()) < 1e-6
