"""States of a scene that can be scored: where the points go and what the camera then sees.

A state is the canonical scene, a deformed state with true images and what carries points to it
(meshes, or points before and after), or a uniform scale
`scale:S`, whose truth is any real test view: points and camera centres that are scaled together
about the origin give the same picture.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

from torch import Tensor

from pcore.capture.load import load_scene, load_state
from pcore.capture.state_folders import state_files
from pcore.data.scene import Scene, View
from pcore.deform.jacobian import estimated_maps
from pcore.deform.simple import uniform_scale
from pcore.editing.handles import HandleDiagnosis
from pcore.errors import InputError, SceneError
from pcore.evaluation.ground_truth import DeformedTruth, load_truth
from pcore.evaluation.state_moves import (
    AFTER,
    BEFORE,
    by_formula,
    carried_by,
    point_files,
    remembered,
    stay,
)
from pcore.geometry.camera import Camera
from pcore.geometry.local_maps import LocalMaps

CANONICAL = "canonical"
ALL = "all"
SCALE = "scale:"
MESHES = "meshes.npz"

Kind = Literal["canonical", "analytic", "skeletal", "edited"]
"""`analytic` states have a formula for all of space, `skeletal` ones come from an animation, and
`edited` ones from an edit file: those have true images only where it is scored against a state."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shot:
    """One picture to take of a state.

    Attributes:
        view: its true image, the caller's camera aside; without a truth that of the rest state.
        camera: where the picture is taken from; the view's own unless the state moves cameras.
        depth: gives the true camera z (H, W), world units, infinite on the background; None when
            the true shape is not known.
    """

    view: View
    camera: Camera
    depth: Callable[[], Tensor] | None


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """A state of a scene and its test views.

    Attributes:
        name: `canonical`, the name of a deformed state, or `scale:S`.
        kind: what sort of deformation it is.
        shots: the pictures to take, at least one.
        move: carries canonical points (N, 3) to the state, world units.
        local_maps: those of canonical points (N, 3) that were moved to (N, 3): from the formula
            of the state where it has one, else estimated from the move; None without a move.
        object_size: diagonal of the bounding box in this state, world units; None without a mesh.
        world: factor by which the truth scales all of the world, lamps and cameras too.
        handles: diagnoses of the edits by anchors that make the state, for canonical points (N, 3);
            None where no edit makes it.
        has_truth: whether its views are true images of it.
    """

    name: str
    kind: Kind
    shots: tuple[Shot, ...]
    move: Callable[[Tensor], Tensor]
    local_maps: Callable[[Tensor, Tensor], LocalMaps | None]
    object_size: float | None
    world: float = 1.0
    handles: Callable[[Tensor], tuple[HandleDiagnosis, ...]] | None = None
    has_truth: bool = True


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneStates:
    """The states of one scene folder.

    Attributes:
        path: the scene's folder.
        scene: its canonical views.
        factor: whole number by which images are down-scaled.
        truth: the true meshes; None when the scene has none.
    """

    path: Path
    scene: Scene
    factor: int
    truth: DeformedTruth | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the deformed states that can be scored."""
        return tuple(name for name in self._pictured if name in self._moved)

    @property
    def left_out(self) -> str | None:
        """Text about states with true images that cannot be scored; None when there are none."""
        names = [name for name in self._pictured if name not in self.names]
        if not names:
            return None
        return (
            f"left out: {', '.join(names)} of {self.path}: true images alone do not say where the "
            f"points go; a state can be scored when {MESHES} holds its true mesh, its folder "
            f"{BEFORE} and {AFTER}, or an edit against it (`--edit FILE --against STATE`)"
        )

    def select(self, wanted: Sequence[str]) -> list[State]:
        """Build the canonical state and those wanted, in this order and without repetition.

        Args:
            wanted: names of states, `scale:S`, or `all` for every state that can be scored.

        Raises:
            InputError: an unknown state (the message lists the known ones) or a bad factor S.
            SceneError: the scene has no test views, or a state has images but no mesh.
        """
        names: list[str] = []
        for name in wanted:
            names += self.names if name == ALL else [name]
        return [self._build(name) for name in dict.fromkeys([CANONICAL, *names])]

    def _build(self, name: str) -> State:
        if name == CANONICAL:
            return self._canonical()
        if name.startswith(SCALE):
            return self._scaled(name)
        if name not in self._pictured:
            known = ", ".join([CANONICAL, *self.names, f"{SCALE}S (for example {SCALE}2)", ALL])
            raise InputError(f"{self.path}: no state {name!r}; expected one of {known}")
        if name not in self.names:
            raise SceneError(
                f"{self.path}: the state {name!r} has true images but no mesh in {MESHES} and no "
                f"{BEFORE} and {AFTER} in its folder, so nothing says where the points go and it "
                f"cannot be scored; choose another state ({', '.join([CANONICAL, *self.names])}), "
                f"or score an edit on its images (--edit FILE --against {name})"
            )
        return self._deformed(name)

    def _canonical(self) -> State:
        return State(
            name=CANONICAL,
            kind="canonical",
            shots=tuple(self._shot(view, None) for view in self._test_views),
            move=stay,
            local_maps=lambda points, moved: None,
            object_size=self._size,
        )

    def _deformed(self, name: str) -> State:
        shots, truth = self.true_shots(name), self.truth
        if truth is None or name not in truth.states:
            files = point_files(self.path / name)
            assert files is not None, "the state is among those that are moved"
            return State(
                name=name,
                kind="skeletal",
                shots=shots,
                move=files.move(),
                local_maps=estimated_maps,
                object_size=None,
            )
        formula = truth.analytic(name)
        return State(
            name=name,
            kind="skeletal" if formula is None else "analytic",
            shots=shots,
            # A formula says where all of space goes, as an edit does; the mesh only its surface.
            move=carried_by(formula) if formula else lambda points: self._carrier(points, name),
            local_maps=by_formula(formula) if formula else estimated_maps,
            object_size=truth.object_size(name),
        )

    def true_shots(self, name: str) -> tuple[Shot, ...]:
        """The test views of a state, whether or not anything says where its points go.

        Raises:
            InputError: no such state.
            SceneError: it has no test views, or they are damaged.
        """
        if name not in self._pictured:
            known = ", ".join(self._pictured) or "none"
            raise InputError(f"{self.path}: no state {name!r} with true images; it has {known}")
        views = load_state(self.path, name, factor=self.factor).split("test")
        if self.size_in(name) is None:
            return tuple(Shot(view=view, camera=view.camera, depth=None) for view in views)
        return tuple(self._shot(view, name) for view in views)

    def size_in(self, name: str) -> float | None:
        """Diagonal of the bounding box in a state, world units; None where no mesh tells."""
        truth = self.truth
        return truth.object_size(name) if truth is not None and name in truth.states else None

    def _scaled(self, name: str) -> State:
        scale = _scale_factor(name)
        shots: list[Shot] = []
        for shot in self._canonical().shots:
            pose = shot.camera.world_from_camera.clone()
            pose[:3, 3] *= scale
            depth = None if shot.depth is None else _times(shot.depth, scale)
            shots.append(Shot(view=shot.view, camera=shot.camera.moved(pose), depth=depth))
        return State(
            name=name,
            kind="analytic",
            shots=tuple(shots),
            move=carried_by(uniform_scale(scale)),
            local_maps=by_formula(uniform_scale(scale)),
            object_size=None if self._size is None else scale * self._size,
            world=scale,
        )

    def _shot(self, view: View, state: str | None) -> Shot:
        truth = self.truth
        depth = None if truth is None else (lambda: truth.depth(state, view.camera))
        return Shot(view=view, camera=view.camera, depth=depth)

    @property
    def _test_views(self) -> tuple[View, ...]:
        return self.scene.split("test")

    @property
    def _size(self) -> float | None:
        return None if self.truth is None else self.truth.object_size()

    @cached_property
    def _pictured(self) -> tuple[str, ...]:
        found = state_files(self.path if self.path.is_dir() else self.path.parent)
        return tuple(name for name, splits in found.items() if "test" in splits)

    @cached_property
    def _moved(self) -> frozenset[str]:
        meshed = () if self.truth is None else tuple(self.truth.states)
        return frozenset(meshed) | {n for n in self._pictured if point_files(self.path / n)}

    @cached_property
    def _carrier(self) -> Callable[[Tensor, str], Tensor]:
        truth = self.truth
        if truth is None:
            raise SceneError(f"{self.path}: no {MESHES}, nothing carries points")
        # The search for closest points is done once per cloud.
        anchors = remembered(truth.anchor)
        return lambda points, state: truth.follow(anchors(points), state)


def open_states(path: Path, *, factor: int = 1, masks: Path | None = None) -> SceneStates:
    """Open a scene folder for scoring.

    Args:
        path: the folder, as for `load_scene`; true meshes are used when it holds `meshes.npz`.
        factor: whole number by which all true images are down-scaled.
        masks: folder of masks of the canonical photos that were made elsewhere.

    Raises:
        SceneError: no scene there, or files missing, damaged or inconsistent.
        InputError: a factor that does not divide the image size.
    """
    scene = load_scene(path, factor=factor, masks=masks)
    truth = load_truth(path) if (path / MESHES).is_file() else None
    return SceneStates(path=path, scene=scene, factor=factor, truth=truth)


def _scale_factor(name: str) -> float:
    text = name.removeprefix(SCALE)
    try:
        scale = float(text)
    except ValueError:
        scale = math.nan
    if not (math.isfinite(scale) and scale > 0):
        raise InputError(f"state {name!r}: expected {SCALE}S with a factor S > 0, got {text!r}")
    return scale


def _times(depth: Callable[[], Tensor], scale: float) -> Callable[[], Tensor]:
    return lambda: depth() * scale
