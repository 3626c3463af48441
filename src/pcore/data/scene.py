"""Views and scenes: what every loader makes and everything else reads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor

from pcore.data.images import Crop, ImageSource, composite
from pcore.data.poses import closest_to_axes, seen_radius
from pcore.data.sparse import SparsePoints
from pcore.errors import InputError, SceneError
from pcore.geometry.camera import Camera
from pcore.geometry.object_region import Region
from pcore.validation import check_count


@dataclass(frozen=True, kw_only=True)
class View:
    """One posed image.

    Attributes:
        name: unique within its split; safe as a file name.
        camera: pose and intrinsics of the (down-scaled) image.
        image: where the pixels come from.
        exact_pose: (4, 4) float64 world_from_camera as in the file, of a scene so far from the
            origin that the camera's is rounded; None elsewhere.
    """

    name: str
    camera: Camera
    image: ImageSource
    exact_pose: Tensor | None = None

    @property
    def has_alpha(self) -> bool:
        """Whether the file, or its mask, separates object from background."""
        return self.image.has_alpha

    def rgba(self) -> Tensor:
        """(H, W, 4) float32 straight alpha in [0, 1], the caller's own copy."""
        return self.image.rgba().clone()

    def rgb(self, background: Tensor) -> Tensor:
        """(H, W, 3) float32 composited over `background` (3,)."""
        return composite(self.image.rgba(), background)

    def alpha(self) -> Tensor:
        """(H, W) float32 opacity; all ones when the file has no alpha channel.

        0 where the photo shows nothing (`valid`).
        """
        return self.image.rgba()[..., 3].clone()

    def valid(self) -> Tensor | None:
        """(H, W) bool: pixels that the photo shows, the caller's own copy; None: all of them.

        Straightening the picture of a lens leaves some at its borders that it does not show. They
        are background in no loss, figure or hull: nothing is known of them.
        """
        valid = self.image.valid()
        return None if valid is None else valid.clone()

    def cropped(self, crop: Crop) -> View:
        """Return the part of a view from left, top to right, bottom; the camera moves along.

        Args:
            crop: pixels of the down-scaled picture.

        Raises:
            InputError: it does not lie in the picture.
        """
        left, top, right, bottom = crop
        camera, factor = self.camera, self.image.factor
        if not (0 <= left < right <= camera.width and 0 <= top < bottom <= camera.height):
            raise InputError(
                f"crop of {self.name}: expected left, top, right and bottom in order inside of "
                f"{camera.width} x {camera.height} pixels, got {crop}"
            )
        x, y = (0, 0) if self.image.crop is None else self.image.crop[:2]
        part = (x + left * factor, y + top * factor, x + right * factor, y + bottom * factor)
        return replace(
            self,
            image=replace(self.image, crop=part),
            camera=replace(
                camera,
                width=right - left,
                height=bottom - top,
                cx=camera.cx - left,
                cy=camera.cy - top,
            ),
        )


@dataclass(frozen=True, kw_only=True)
class Skipped:
    """A picture of a capture that is not used.

    Attributes:
        name: of the picture, as the capture's files write it.
        reason: why, to be read after the name.
    """

    name: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class Split:
    """The views of one split as a loader made them.

    Attributes:
        views: at least one.
        notes: what is odd about the files and was not refused, a sentence each.
    """

    views: tuple[View, ...]
    notes: tuple[str, ...] = ()


class SplitsOnDemand(Mapping[str, tuple[View, ...]]):
    """Splits of a scene by name, each read once, when it is first asked for."""

    def __init__(self, readers: Mapping[str, Callable[[], Split]]) -> None:
        """Remember how to read every split; reading raises SceneError for damaged files."""
        self._readers = dict(readers)
        self._known: dict[str, Split] = {}

    def __getitem__(self, name: str) -> tuple[View, ...]:
        if name not in self._known:
            self._known[name] = self._readers[name]()
        return self._known[name].views

    def __contains__(self, name: object) -> bool:
        return name in self._readers  # The inherited answer would read the split.

    def __iter__(self) -> Iterator[str]:
        return iter(self._readers)

    def __len__(self) -> int:
        return len(self._readers)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was odd about the splits that were read so far, each sentence once."""
        return tuple(dict.fromkeys(note for split in self._known.values() for note in split.notes))


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Posed images of one object.

    Attributes:
        name: of the folder.
        root: folder that the images lie in.
        views: split name -> views; at least one split, none of them empty. Loaders hand over
            splits that are read when they are asked for.
        states: names of deformed states whose test views `load_state` reads.
        folder: what `load_scene` was given; None for scenes that come from elsewhere.
        factor: whole number by which its images were down-scaled.
        layout: name of the layout that it was read from.
        sparse: points of the reconstruction that posed the photos; None where there are none.
        region: where the object is, as its files say or as it was found; None where that is not
            known.
        skipped: pictures that its files name, or that lie beside the others, and are not used.
        masks: folder of masks that were made for it elsewhere; None where it brings its own, or
            has none.

    Views of one scene may differ in size and lens.

    Without a `region` that of the object comes from the poses of the training views alone (of all
    views when there is no training split, as in a deformed state): no image is looked at, no test
    pose when there are training poses. `pcore.training.locate` finds a better one.
    """

    name: str
    root: Path
    views: Mapping[str, tuple[View, ...]]
    states: tuple[str, ...] = ()
    folder: Path | None = None
    factor: int = 1
    layout: str = "NeRF-Synthetic"
    sparse: SparsePoints | None = None
    region: Region | None = None
    skipped: tuple[Skipped, ...] = ()
    masks: Path | None = None

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the splits that are there."""
        return tuple(self.views)

    def split(self, name: str) -> tuple[View, ...]:
        """Return the views of one split.

        Raises:
            SceneError: the scene has none of that name, or its files are missing or damaged.
        """
        if name not in self.views:
            raise SceneError(
                f"scene {self.root}: no split {name!r}; it has {', '.join(self.views) or 'none'}"
            )
        return self.views[name]

    @property
    def notes(self) -> tuple[str, ...]:
        """What is odd about the files read so far and was not refused, a sentence each."""
        return self.views.notes if isinstance(self.views, SplitsOnDemand) else ()

    @cached_property
    def center(self) -> Tensor:
        """(3,) the region's middle; without one the point closest to the viewing axes.

        By least squares, in world units.
        """
        if self.region is not None:
            return self.region.center
        cameras = self._cameras
        poses = torch.stack([camera.world_from_camera for camera in cameras])
        point = closest_to_axes(poses)
        if point is None:
            why = "".join(f" ({note})" for note in self.notes)
            raise SceneError(
                f"scene {self.root}: the viewing axes of its {len(cameras)} view(s) are parallel, "
                "so they do not tell where the object is; give views from at least two directions"
                f"{why}"
            )
        return point.float()

    @property
    def lower(self) -> Tensor:
        """(3,) lower corner of the object's region, world units."""
        return self.center - self.radius if self.region is None else self.region.bounds[0]

    @property
    def upper(self) -> Tensor:
        """(3,) upper corner of the object's region, world units."""
        return self.center + self.radius if self.region is None else self.region.bounds[1]

    @cached_property
    def radius(self) -> float:
        """Radius of the region, world units.

        Without one that of the largest sphere about `center` that every view sees whole. The cube
        around it is the region then: its inner part is in every field of view, and an object that
        fills the images without being cut off fits in.
        """
        if self.region is not None:
            return self.region.radius
        radii = [
            seen_radius(camera, camera.world_from_camera, self.center) for camera in self._cameras
        ]
        inside = [radius for radius in radii if radius > 0]
        if not inside:
            raise SceneError(
                f"scene {self.root}: no view sees the point {self.center.tolist()} that the "
                "viewing axes come closest to; check that poses are camera-to-world, OpenGL axes"
            )
        return min(inside)

    @cached_property
    def _cameras(self) -> tuple[Camera, ...]:
        views = self.views.get("train") or tuple(v for split in self.views.values() for v in split)
        return tuple(view.camera for view in views)


def hold_out(views: tuple[View, ...], *, every: int) -> tuple[tuple[View, ...], tuple[View, ...]]:
    """Split training views into views to fit and held-out views to validate on.

    Every `every`-th view is held out, starting in the middle of the first group, so that the same
    views always give the same split and a path of cameras is sampled evenly.

    Args:
        views: training views in the order of the scene file.
        every: at least 2.

    Returns:
        (fit, validation); validation is empty when there are too few views to reach the first.
    """
    check_count("held-out views: every", every, minimum=2)
    start = every // 2
    held = views[start::every]
    return tuple(v for i, v in enumerate(views) if i % every != start), held


def check_images(views: Iterable[View]) -> None:
    """Decode every image once, so that a damaged one is found before hours of training.

    Raises:
        SceneError: an image is missing, truncated or damaged; names the file.
    """
    for view in views:
        view.rgba()
