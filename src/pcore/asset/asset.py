"""A trained object as one value: what it is made of, where it comes from, and how it is drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Unpack, overload

from torch import Tensor

from pcore.asset.content import Color, Content, LightName, RaysName, Sampling, checked_color
from pcore.asset.posed_asset import How, Posed, checked_cameras, checked_rays, content_of
from pcore.asset.posing import Edit, EditLike, begin_with, bind_motion, check_bound
from pcore.capture.load import load_scene
from pcore.contrib.learned_skinning import Skinning
from pcore.data.scene import Scene
from pcore.editing.anchors import AnchorRig, rig_with
from pcore.editing.session import EditSession
from pcore.editing.state import EditState
from pcore.errors import InputError
from pcore.files.provenance import Provenance
from pcore.files.run_record import RunRecord
from pcore.gaussians.splats import Splats, SplatsAtRest
from pcore.geometry.camera import Camera
from pcore.geometry.rays import RayBundle
from pcore.relight.relighting import Relighting
from pcore.render.image import Image

WHITE: Color = (1.0, 1.0, 1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Asset:
    """A trained object; made by `pcore.load`, `pcore.train` and `pcore.finetune`.

    Everything that goes in or comes out (edits, cameras, rays, points, depth, surface) is in world
    units and axes and passes through here; its content keeps its own.

    Attributes:
        content: what it is made of.
        provenance: where it comes from.
        record: how it came to be, and the folder of its run.
        read_skinning: gives the weights that it learned for edits by anchors; None where none.
    """

    content: Content[Any]
    provenance: Provenance
    record: RunRecord
    read_skinning: Callable[[], Skinning] | None = field(default=None, repr=False)

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        return f"Asset({self.content!r})"

    @property
    def points(self) -> Tensor:
        """(N, 3) canonical points, world units, on the CPU; autograd does not follow them."""
        return self.content.points

    @cached_property
    def skinning(self) -> Skinning | None:
        """The learned weights, read when they are first needed.

        Raises:
            CheckpointError: their file is damaged or belongs to other points.
        """
        return None if self.read_skinning is None else self.read_skinning()

    @property
    def light(self) -> Relighting | None:
        """The light of its photos; None where none was estimated.

        Raises:
            CheckpointError: its file is damaged or belongs to other points.
        """
        return self.content.light

    @cached_property
    def rig(self) -> AnchorRig | None:
        """Anchors with the learned weights, for edits by anchors; None where none were learned."""
        return None if self.skinning is None else rig_with(self.skinning.paths, self.skinning)

    @cached_property
    def splats_at_rest(self) -> SplatsAtRest:
        """Gaussians that show it at rest and go with its points."""
        return self.content.splats()

    def pose(
        self,
        edit: Edit | None = None,
        *,
        time: float | None = None,
        rays: RaysName = "aware",
        light: LightName | None = None,
    ) -> Posed:
        """Move the object; None leaves it as it was photographed.

        Args:
            edit: an edit file (its path, its content or what `load_edit` returns), an
                `EditSession` or a state of one, a `Deformation`, or `MovedPoints`.
            time: for an edit file with keyframes.
            rays: how its deformed points are seen.
            light: "still": the light stays where it is; "baked": every point keeps the brightness
                of the photos. None: still where the object has a light and rays are aware.

        Raises:
            EditError: the edit is not valid, does not fit the points or folds space.
            InputError: something else than the above, of another object, or a light is asked for
                and there is none.
        """
        aware = rays == "aware" or light == "still"
        bound = bind_motion(edit, self.points, lambda: self.rig, time=time, aware=aware)
        posed = self.content.pose(bound.motion, rays=rays, light=light)
        return Posed.of(self.content, posed, bound.notes)

    def splats(
        self,
        posed: Posed | EditState | EditSession | None,
        eye: Tensor,
        *,
        gains: Tensor | None = None,
    ) -> Splats:
        """Show the object as splats, as browsers draw them, in its colours for one place.

        Neural points become flat discs, which take a second the first time.

        Args:
            posed: from `pose`, or straight from a session, which is faster; None: as photographed.
            eye: (3,) where it is seen from, world units.
            gains: (N,) factors on the brightness; None takes those of `posed`.

        Raises:
            InputError: of another object.
        """
        state = posed.state if isinstance(posed, EditSession) else posed
        if state is None:
            return self.splats_at_rest.moved(self.points, None, eye, gains)
        if not isinstance(state, Posed):
            check_bound(state.bound, self.splats_at_rest.points)
            return self.splats_at_rest.moved(state.points, state.bound.linear, eye, gains)
        own, linear = self.gains_of(state), state.linear
        return self.splats_at_rest.moved(state.points, linear, eye, own if gains is None else gains)

    def lit(self, posed: Posed, gains: Tensor | None = None) -> Posed:
        """Light what was posed with `light="baked"` and aware rays: the second stage of a picture.

        Gains are (N,) of what was posed last; None finds those of the light of the photos.
        """
        return replace(posed, content=self.content.lit(content_of(posed, self.content), gains))

    def gains_of(self, posed: Posed) -> Tensor | None:
        """(N,) factors by which the light on its points has changed; None: as in the photos."""
        return self.content.gains_of(content_of(posed, self.content))

    @overload
    def render(self, posed: Posed | None, cameras: Camera, **how: Unpack[How]) -> Image: ...

    @overload
    def render(
        self, posed: Posed | None, cameras: Sequence[Camera], **how: Unpack[How]
    ) -> list[Image]: ...

    def render(
        self,
        posed: Posed | None,
        cameras: Camera | Sequence[Camera],
        **how: Unpack[How],
    ) -> Image | list[Image]:
        """Take pictures, on the device of the networks.

        Autograd follows the pose and the cameras where they ask for it; the whole picture is then
        held in memory.

        Args:
            posed: from `pose`; None is the object as it was photographed.
            cameras: a camera or a batch (`Camera.stack`) of at least 4 x 4 pixels, or several
                cameras of any sizes.
            **how: `samples`, rays per pixel, a square number, no matter for Gaussians; `fast=True`,
                not exact, in less time; `detail` of `film_detail`; `cancel`, True ends the work;
                `progress`, told which share is done. More under `Sampling`.

        Returns:
            A picture (of a batch with its axis in front), or one for each of several cameras.

        Raises:
            InputError: a pose of another object, no camera, a picture that is too small, rays per
                pixel that make no square, or points that are not finite.
            RenderCancelledError: `cancel` said so.
        """
        content = content_of(self.pose() if posed is None else posed, self.content)
        sampling = Sampling(**how)
        if isinstance(cameras, Camera):
            return self.content.render(content, cameras, sampling)
        return [
            self.content.render(content, camera, sampling.of(number, len(cameras)))
            for number, camera in enumerate(checked_cameras(cameras))
        ]

    def film(
        self, frames: Sequence[Posed], cameras: Sequence[Camera], *, samples: int | None = None
    ) -> Iterator[Image]:
        """Take the pictures of a film one by one, all sampled alike, as `pcore animate` does.

        Args:
            frames: the object in every frame.
            cameras: one for every frame.
            samples: see `render`.

        Raises:
            InputError: as `render`, or not one camera for every frame.
        """
        detail = self.film_detail(frames, cameras)
        for posed, camera in zip(frames, cameras, strict=True):
            yield self.render(posed, camera, samples=samples, detail=detail)

    def film_detail(self, frames: Sequence[Posed], cameras: Sequence[Camera]) -> float | None:
        """Number that all frames of a film share, so that its look does not jump."""
        poses = [content_of(one, self.content) for one in frames]
        return self.content.film_detail(poses, checked_cameras(cameras, len(frames)))

    def trace(
        self, posed: Posed | None, rays: RayBundle, background: Tensor | Color | None = None
    ) -> Image:
        """Render rays of pixels (..., H, W) in one piece, with what each hits; autograd follows.

        Args:
            posed: from `pose`; None is the object as it was photographed.
            rays: world units.
            background: (3,) colour behind the object; None takes its own.

        Raises:
            InputError: no rays, not of unit length or not finite, or a background of no colour.
        """
        content = content_of(self.pose() if posed is None else posed, self.content)
        return self.content.trace(content, checked_rays(rays), checked_color(background))

    def session(self, edit: EditLike | None = None, *, time: float | None = None) -> EditSession:
        """Begin to edit it step by step, with the weights it learned; see `EditSession`.

        Args:
            edit: an edit file or edit to begin with.
            time: of one with keyframes, which then stands still; None keeps them.

        Raises:
            EditError: the edit is not valid or does not fit the points.
        """
        return EditSession(self.points, begin_with(edit, time), rig=self.rig)

    def over(self, background: Color) -> Asset:
        """Return the same before another background, RGB in [0, 1], else raises InputError."""
        return replace(self, content=self.content.over(checked_color(background, fixed=True)))

    def scene(self, folder: Path | None = None, *, factor: int | None = None) -> Scene:
        """Open the scene that it was trained on.

        Args:
            folder: of the scene; None takes the one on record.
            factor: by which images are down-scaled; None takes that of the training.

        Raises:
            InputError: none is given and that on record is not here.
            SceneError: the scene is damaged.
        """
        record, masks = self.record, self.record.masks if folder is None else None
        chosen = record.factor if factor is None else factor
        scene = load_scene(record.scene_or(folder), factor=chosen, masks=masks)
        return scene if record.region is None else replace(scene, region=record.region)

    @property
    def settings(self) -> Any:
        """What `pcore.train` or `pcore.finetune` was given; InputError where none is on record."""
        from pcore.asset.training import settings_of

        return settings_of(self.record)

    @property
    def path(self) -> Path:
        """Folder of its run; raises InputError where it has none, `save` makes one."""
        if self.record.path is None:
            raise InputError(
                "asset: expected one with a folder, got one that was never saved or a bare model "
                "file; write it with `asset.save(FOLDER)`"
            )
        return self.record.path

    def save(self, path: Path | str) -> Asset:
        """Write it into a new or empty folder, which all commands then read; return it from there.

        Raises:
            InputError: the folder holds something already.
            TrainingError: it cannot be written.
            CheckpointError: weights that are not finite, or a light or weights that are damaged.
        """
        from pcore.asset.saving import save_asset

        return save_asset(self, Path(path))
