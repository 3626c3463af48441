"""Who takes the pictures of a benchmark: the embedded ray caster, or Blender's Cycles."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pcore.benchmark.look import FloatArray, Look
from pcore.benchmark.true_picture import Shape, Shot, take

RendererName = Literal["embedded", "blender"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """One picture: where it goes, of which shape, from where.

    Attributes:
        path: of the picture.
        shape: what is there; jobs of one state share it.
        pose: (4, 4) OpenGL camera-to-world.
        angle_x: horizontal field of view, radians.
    """

    path: Path
    shape: Shape
    pose: FloatArray
    angle_x: float


Renderer = Callable[[Sequence[Job]], Iterator[Shot]]
"""Takes the pictures in their order."""


def embedded(look: Look, *, resolution: int, lit: Shape | None) -> Renderer:
    """The ray caster of this package, on all cores.

    Args:
        look: what is painted on the shapes.
        resolution: pixels along each side.
        lit: the shape that the light finds; None: the one that is drawn.
    """

    def one(job: Job) -> Shot:
        return take(
            job.shape,
            look,
            lit or job.shape,
            job.pose,
            angle_x=job.angle_x,
            resolution=resolution,
        )

    def all_of(jobs: Sequence[Job]) -> Iterator[Shot]:
        with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
            yield from pool.map(one, jobs)

    return all_of
