"""What a step of a training costs: a model of two numbers, fitted to measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_LEAST = 1e-9


@dataclass(frozen=True, kw_only=True)
class Speed:
    """Seconds of a training step of Gaussians: drawing, gradients, optimiser.

    The defaults are those of one core of a server; only their ratios matter where nothing was
    measured.
    """

    fixed: float = 3e-3
    pixel: float = 6e-7
    """Per pixel of a picture."""
    gaussian: float = 1.8e-6
    """Per Gaussian."""

    def seconds(self, pixels: float, gaussians: float) -> float:
        """Of one step with pictures of so many pixels and so many Gaussians."""
        return self.fixed + self.pixel * pixels + self.gaussian * gaussians


def speed_from(samples: Sequence[tuple[float, float, float]]) -> Speed:
    """Fit to measured (pixels, Gaussians, seconds), at least three; no part is below zero."""
    table = np.array(samples, dtype=np.float64)
    columns = np.column_stack([np.ones(len(table)), table[:, :2]])
    # Relative errors: a cheap step is as well known as a dear one.
    weighted = columns / table[:, 2:]
    parts, *_ = np.linalg.lstsq(weighted, np.ones(len(table)), rcond=None)
    fixed, pixel, gaussian = (max(float(one), _LEAST) for one in parts)
    return Speed(fixed=fixed, pixel=pixel, gaussian=gaussian)
