"""Write a deformation of your own and compare how runs render it.

    python examples/03_own_deformation.py wave.png RUN RUN-pcore

One row per run: canonical on the left, deformed on the right.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro
from torch import Tensor

import pcore
from pcore.data.pictures import write_png


@dataclass(frozen=True)
class Wave(pcore.Deformation):
    """Lift every point by a sine of its x; lengths in world units.

    A deformation says where points go, for any batch of them and point by point. The Jacobian
    comes from autograd; override `jacobian` where there is a short formula.
    """

    height: float
    length: float

    def __call__(self, points: Tensor) -> Tensor:
        """Map points (..., 3)."""
        x, y, z = points.unbind(dim=-1)
        lift = self.height * torch.sin(2 * math.pi * x / self.length)
        return torch.stack([x, y, z + lift], dim=-1)


def compare(run: Path, wave: Wave, size: int) -> Tensor:
    """Canonical and deformed rendering of a run side by side, (size, 2 size, 3)."""
    asset = pcore.load(run)
    determinant = torch.linalg.det(wave.jacobian(asset.points))
    print(f"{run}: det J from {float(determinant.min()):.3f} to {float(determinant.max()):.3f}")
    bent = asset.pose(wave)  # Raises EditError where the wave folds space.
    camera = pcore.orbit_around(bent.points, size=(size, size))[0]
    return torch.cat([asset.render(posed, camera).rgb for posed in (asset.pose(), bent)], dim=1)


def main(picture: Path, run: Path, others: tuple[Path, ...] = (), /, size: int = 300) -> None:
    """Render runs under a wave.

    Args:
        picture: PNG file to write.
        run: folder of a run.
        others: more runs, such as the same after fine-tuning.
        size: width and height of each rendering in pixels.
    """
    wave = Wave(height=0.15, length=1.0)
    write_png(picture, torch.cat([compare(one, wave, size) for one in (run, *others)]))
    print(f"written to {picture}")


if __name__ == "__main__":
    tyro.cli(main)
