"""What can be inside an asset, and how its points were carried where no map of space says it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar, get_args

import torch
from torch import Tensor

from pcore.deform.base import Deformation
from pcore.errors import InputError
from pcore.files.provenance import Provenance
from pcore.gaussians.splats import SplatsAtRest
from pcore.geometry.camera import Camera
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.pixel_samples import check_samples
from pcore.geometry.rays import RayBundle
from pcore.geometry.surfels import Surfels
from pcore.relight.light_file import LIGHT_FILE, load_light
from pcore.relight.relighting import Relighting
from pcore.render.image import Image

RaysName = Literal["aware", "plain"]
"""How deformed points are seen: aware of the deformation, or plain as in the paper."""
LightName = Literal["still", "baked"]
"""What the light does while an object moves: it stays where it is, or it is carried along."""
Color = tuple[float, float, float]
"""Red, green and blue in [0, 1]."""

P = TypeVar("P")


@dataclass(frozen=True, kw_only=True, eq=False)
class MovedPoints:
    """Where canonical points went, when it was not a map of space that moved them.

    Attributes:
        positions: (N, 3) of all points of the asset, world units.
        local_maps: how space moved around every point; None: `Asset.pose` estimates it where the
            rays are aware (`estimated_maps`).
        world: factor by which all of the world, lamps too, was scaled about the origin meanwhile.
    """

    positions: Tensor
    local_maps: LocalMaps | None = None
    world: float = 1.0

    def __post_init__(self) -> None:
        if self.positions.ndim != 2 or self.positions.shape[-1] != 3:
            raise InputError(
                f"moved points: expected positions (N, 3), got {tuple(self.positions.shape)}"
            )
        bad = int((~self.positions.isfinite().all(dim=1)).sum())
        if bad:
            raise InputError(
                f"moved points: expected finite positions, got NaN or infinity in {bad} of "
                f"{len(self.positions)}; look at what moved them"
            )


Motion = Deformation | MovedPoints
"""What moves an object."""


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """How a picture is taken.

    Attributes:
        samples: rays per pixel, a square number; None takes those that the object was trained for.
            Gaussians need one, and more change nothing: pixels wider than those that they learned
            from are divided anyhow, unless it is to be `fast` (ADR 46).
        fast: leave out what adds little to a colour, and send one ray per pixel unless `samples`
            says otherwise: less time, and not exact (`FAST_THRESHOLD`).
        detail: one number for all frames of a film (`Asset.film_detail`); None measures it.
        cancel: asked now and then; True ends the work.
        progress: told now and then which share of the work is done, in (0, 1].
    """

    samples: int | None = None
    fast: bool = False
    detail: float | None = None
    cancel: Callable[[], bool] | None = None
    progress: Callable[[float], None] | None = None

    def __post_init__(self) -> None:
        if self.samples is not None:
            check_samples("samples", self.samples)

    def of(self, number: int, count: int) -> Sampling:
        """Return that of one picture of several, whose progress is a part of the whole."""
        tell = self.progress
        if tell is None:
            return self

        def told(share: float) -> None:
            tell((number + share) / count)

        return replace(self, progress=told)


class Content(Protocol[P]):
    """One kind of object, in its own units and axes; P is what it is when it is posed.

    `Asset` holds one and gives it edits, cameras and rays; nobody else needs to know which kind.
    """

    @property
    def points(self) -> Tensor:
        """(N, 3) canonical points, float32 on the CPU: what edits are bound to."""
        ...

    @property
    def samples(self) -> int:
        """Rays per pixel of its pictures."""
        ...

    @property
    def read_light(self) -> Callable[[], Relighting] | None:
        """Gives the light of its photos; None where none was estimated."""
        ...

    @property
    def light(self) -> Relighting | None:
        """The light of its photos; None where none was estimated."""
        ...

    @property
    def surfels(self) -> Surfels | None:
        """The pieces of surface over its points at rest; None where nobody has estimated them."""
        ...

    def splats(self) -> SplatsAtRest:
        """Make Gaussians that show it at rest and go with its points."""
        ...

    def pose(self, motion: Motion | None, *, rays: RaysName, light: LightName | None) -> P:
        """Move it; None leaves it as it was photographed.

        Raises:
            EditError: a map that folds space, where that matters.
            InputError: a light is asked for and there is none.
        """
        ...

    def points_of(self, posed: P) -> Tensor:
        """(N, 3) where the points of what was posed are."""
        ...

    def local_maps_of(self, posed: P) -> LocalMaps | None:
        """How space moved around them; None where nothing remembers it."""
        ...

    def lit(self, posed: P, gains: Tensor | None) -> P:
        """Return what was posed under a light.

        Args:
            posed: with shapes carried along, as "aware" does.
            gains: (N,) as `gains_of`; None finds those of the light of the photos, which stands
                still; without such a light nothing changes.
        """
        ...

    def gains_of(self, posed: P) -> Tensor | None:
        """(N,) factors on the brightness of its points, for a light; None: that of the photos."""
        ...

    def trace(self, posed: P, rays: RayBundle, background: Tensor | Color | None) -> Image:
        """Render rays of pixels (..., H, W), with what each hits; autograd follows."""
        ...

    def render(self, posed: P, camera: Camera, sampling: Sampling) -> Image:
        """Take a picture, or those of a batch of cameras; autograd follows."""
        ...

    def film_detail(self, posed: Sequence[P], cameras: Sequence[Camera]) -> float | None:
        """Number that all frames of a film share, so that its look does not jump."""
        ...

    def over(self, background: Color) -> Content[P]:
        """Return the same before another background."""
        ...

    def save(self, folder: Path, provenance: Provenance) -> None:
        """Write its files into a folder.

        Raises:
            CheckpointError: it is not finite; nothing is written.
            OSError: a file cannot be written.
        """
        ...


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Lit(ABC):
    """What photos may have told the light of.

    Attributes:
        read_light: gives the light of the photos; None where none was estimated.
    """

    read_light: Callable[[], Relighting] | None = None

    def __repr__(self) -> str:
        points = self.points
        size = " x ".join(f"{side:.3g}" for side in (points.amax(dim=0) - points.amin(dim=0)))
        light = "no light" if self.read_light is None else "a light"
        return f"{type(self).__name__}({len(points)} points, {size}, {light})"

    @property
    @abstractmethod
    def points(self) -> Tensor:
        """See `Content.points`."""

    @property
    def light(self) -> Relighting | None:
        """The light of the photos, read when it is first needed.

        Raises:
            CheckpointError: its file is damaged or belongs to other points.
        """
        return None if self.read_light is None else self.read_light()


def light_beside(path: Path, points: Callable[[], Tensor]) -> Callable[[], Relighting] | None:
    """What reads the light that lies in a folder, once and when it is needed; None: there is none.

    Args:
        path: the folder; a bare file has none beside it.
        points: gives the (K, 3) canonical points that it falls on, world units.
    """
    light = path / LIGHT_FILE
    return cache(lambda: load_light(light, points())) if light.is_file() else None


def wanted_light(
    read: Callable[[], Relighting] | None, rays: RaysName, light: LightName | None
) -> Relighting | None:
    """The light that stands still in pictures with these rays; None where it is baked in.

    Args:
        read: reads the light of the photos; None where nobody has estimated it.
        rays: of the pictures.
        light: what is asked for; None: still where there is one and rays are aware.

    Raises:
        InputError: a name that is not known, or a light that stands still where there is none.
        CheckpointError: its file is damaged or belongs to other points.
    """
    _check_name("rays", rays, get_args(RaysName))
    _check_name("light", light, (*get_args(LightName), None))
    if light == "baked" or (light is None and rays == "plain"):
        return None
    if light == "still" and read is None:
        raise InputError(
            "light: expected a light.safetensors in the folder of the run, found none; estimate it "
            "with `pcore light RUN`, or let it be baked in (--light baked)"
        )
    return None if read is None else read()


def checked_color(color: Any, *, fixed: bool = False) -> Any:
    """Return a background as it came, if any, or, to be kept (`fixed`), as three numbers.

    Raises:
        InputError: no three numbers in [0, 1], or a gradient is asked for of what is kept.
    """
    if color is None and not fixed:
        return None
    try:
        values = torch.as_tensor(color).detach()
    except (TypeError, ValueError, RuntimeError):
        values = torch.zeros(0)
    if tuple(values.shape) != (3,) or not bool(((values >= 0) & (values <= 1)).all()):
        raise InputError(f"background: expected red, green and blue in [0, 1], got {color!r}")
    if not fixed:
        return color
    if isinstance(color, Tensor) and color.requires_grad:
        raise InputError(
            "background: a gradient is asked for, and a background that is kept has none; give it "
            "to `asset.trace`, or detach it"
        )
    return tuple(map(float, values))


def _check_name(what: str, name: str | None, known: Sequence[str | None]) -> None:
    """Refuse a name with a slip of the pen, which would be taken for the other one."""
    if name not in known:
        raise InputError(f"{what}: expected one of {', '.join(map(repr, known))}, got {name!r}")
