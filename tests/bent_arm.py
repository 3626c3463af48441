"""A deformation whose parameter asks for a gradient."""

from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.deform.base import Deformation


@dataclass(frozen=True)
class Arm(Deformation):
    """Turn what lies beyond x = 0 about y by an angle that grows with x, a parameter of torch."""

    angle: Tensor

    def __call__(self, points: Tensor) -> Tensor:
        x, y, z = points.unbind(dim=-1)
        angle = self.angle.to(points) * x.clamp_min(0).square()
        cos, sin = angle.cos(), angle.sin()
        return torch.stack([cos * x + sin * z, y, cos * z - sin * x], dim=-1)
