"""Exposure and white balance of every photo: an affine map of colours that training learns along.

A camera that measures its exposure anew for every photo shows one surface in several colours. Left
alone, that becomes haze, or colours that change with the view. What the photos have in common stays
in the object: the mean of all maps is the identity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from pcore.errors import CheckpointError

_RATE = 2e-3
"""Of Adam at the start; a cosine takes it to a hundredth."""
_LAST = 0.01


class ViewExposure:
    """One affine map of colours (3, 4) per training view, with its own Adam."""

    def __init__(self, views: int, device: torch.device) -> None:
        """Begin at the identity for all views."""
        self.change = nn.Parameter(torch.zeros(views, 3, 4, device=device))
        """What is added to the identity, before the mean of all is taken away."""
        self._adam = torch.optim.Adam([self.change], lr=_RATE)

    def maps(self) -> Tensor:
        """(V, 3, 4): colour c of the object is c -> M[:, :3] c + M[:, 3] in each photo."""
        maps = self.change.detach() - self.change.detach().mean(dim=0)
        maps[:, :, :3] += torch.eye(3, device=maps.device)
        return maps

    def applied(self, view: int, rgb: Tensor, alpha: Tensor, background: Tensor) -> Tensor:
        """A picture as a photo shows it; the background, which is ours, stays as it is.

        Args:
            view: number of the training view.
            rgb: (..., 3) over the background; differentiated.
            alpha: (...) opacity; differentiated.
            background: (3,).
        """
        opacity = alpha.unsqueeze(-1)
        shown = rgb - (1 - opacity) * background
        # The mean has no gradient: one photo says nothing about the others.
        change = self.change[view] - self.change.detach().mean(dim=0)
        return rgb + shown @ change[:, :3].T + opacity * change[:, 3]

    def step(self, progress: float) -> None:
        """Follow the gradients that were summed since the last step, at a progress from 0 to 1."""
        height = 0.5 * (1 + math.cos(math.pi * progress))
        self._adam.param_groups[0]["lr"] = _RATE * (_LAST + (1 - _LAST) * height)
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)

    def state(self) -> dict[str, Any]:
        """What `restore` needs to go on exactly."""
        return {"change": self.change.detach(), "adam": self._adam.state_dict()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Put this into a saved state.

        Raises:
            CheckpointError: the state has none, or is of another number of views.
        """
        if not state or state["change"].shape != self.change.shape:
            raise CheckpointError(
                f"training state: expected the exposure of {len(self.change)} views, got "
                f"{len(state['change']) if state else 'none'}; resume with the options and photos "
                "that it was started with"
            )
        with torch.no_grad():
            self.change.copy_(state["change"])
        self._adam.load_state_dict(state["adam"])


def fitted_exposure(rgb: Tensor, photo: Tensor) -> Tensor:
    """Pixels (N, 3) under the affine map of colours that brings them closest to a photo's (N, 3).

    It looks at the photo: figures after it say how well shapes and colours agree but for exposure,
    and are no figures of what is drawn.
    """
    known = torch.cat([rgb, torch.ones_like(rgb[:, :1])], dim=1).double()
    # The normal equations with a trace of the identity: flat pictures have many solutions.
    guard = 1e-6 * len(rgb) * torch.eye(4, dtype=torch.float64, device=rgb.device)
    identity = torch.eye(4, 3, dtype=torch.float64, device=rgb.device)
    found = torch.linalg.solve(known.T @ known + guard, known.T @ photo.double() + guard @ identity)
    return (known @ found).to(rgb)
