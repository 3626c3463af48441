"""Take every picture of every state with every method, and score it."""

from __future__ import annotations

import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.evaluation.health import NO_HEALTH, Health
from pcore.evaluation.protocol import PAPR, STANDARD, Perceptual, Protocol, measure
from pcore.evaluation.states import Kind, State
from pcore.geometry.camera import Camera
from pcore.metrics.geometry_metrics import GeometryScores, TrueGeometry, measure_geometry
from pcore.render.image import Image
from pcore.training.ranks import current_ranks

Value = float | int | None
Progress = Callable[[int, int], None]

Tells = Literal["depth", "opacity", "colour"]
"""What pictures of a method say: also how far away surfaces are, opacity alone, or neither."""


class Method(typing.Protocol):
    """One of the methods that are compared, whatever draws its pictures.

    Attributes:
        name: for tables; unique among the methods.
        tells: what its pictures say.
    """

    @property
    def name(self) -> str:
        """See the class."""
        ...

    @property
    def tells(self) -> Tells:
        """See the class."""
        ...

    def pose(self, state: State) -> Any:
        """Move what is drawn to a state.

        Raises:
            PcoreError: it cannot be moved there, as where a field folds space.
        """
        ...

    def draw(self, posed: Any, camera: Camera) -> Image:
        """Take a picture of what was posed, on white, on any device.

        What `tells` leaves out may be anything in it.
        """
        ...

    def health(self, posed: Any, state: State) -> Health | None:
        """What the state does to its points; None where it has none to speak of."""
        ...


@dataclass(frozen=True, kw_only=True)
class ImageRow:
    """Scores of one picture of one method under one protocol.

    Attributes:
        method: name of the method.
        state: name of the state.
        kind: of the state.
        protocol: name of the protocol that the image metrics follow.
        view: name of the test view.
        scores: metric -> value; None where it is not defined or not known.
    """

    method: str
    state: str
    kind: Kind
    protocol: str
    view: str
    scores: Mapping[str, Value]


@dataclass(frozen=True, kw_only=True, eq=False)
class Taken:
    """The pictures of one shot, for whoever wants to show them.

    Attributes:
        state: the state.
        view: name of the test view.
        index: position of the view among the state's.
        rgba: (H, W, 4) truth, straight alpha; None where there is none.
        depth: (H, W) true camera z, infinite on the background; None when not known.
        photos: method -> what it rendered.
        camera: where the pictures were taken from.
        health: method -> what the state does to its points; None where it has none.
        unseen: method -> pixels (H, W) bool that show points which no training view saw; None
            where that is not known.
        valid: (H, W) pixels that the truth shows; None: all.
    """

    state: str
    view: str
    index: int
    rgba: Tensor | None
    depth: Tensor | None
    photos: Mapping[str, Image]
    camera: Camera
    health: Mapping[str, Health | None]
    unseen: Mapping[str, Tensor | None]
    valid: Tensor | None = None


def evaluate(
    methods: Sequence[Method],
    states: Sequence[State],
    *,
    protocols: Sequence[Protocol] = (PAPR, STANDARD),
    perceptual: Perceptual | None = None,
    progress: Progress | None = None,
    show: Callable[[Taken], None] | None = None,
) -> list[ImageRow]:
    """Score methods on states of a scene.

    Args:
        methods: at least one, names unique.
        states: from `SceneStates.select`.
        protocols: ways to score images; every picture is taken once and scored by each.
        perceptual: LPIPS networks; None leaves LPIPS out.
        progress: called with (pictures done, pictures in all).
        show: called with the pictures of every shot as soon as they are taken; they are not kept.

    Returns:
        One row per picture and protocol: states, views, methods, protocols from slow to fast. Of
        processes that work together the first has all of them, the others none.

    Raises:
        InputError: no method, names that repeat, or a picture that cannot be measured.
        EditError: a state folds space where a method draws with aware rays.
    """
    _check_names(methods)
    # All poses first: a state that cannot be drawn must not cost the pictures of those before.
    carried = [{method.name: method.pose(state) for method in methods} for state in states]
    jobs = [(n, index) for n, state in enumerate(states) for index in range(len(state.shots))]

    @cache
    def health_of(n: int) -> dict[str, Health | None]:
        return {one.name: one.health(carried[n][one.name], states[n]) for one in methods}

    def scored(job: int) -> list[ImageRow]:
        n, index = jobs[job]
        taken = _take(methods, carried[n], health_of(n), states[n], index)
        if show is not None:
            show(taken)
        return _score(methods, taken, states[n], protocols, perceptual)

    rows: list[ImageRow] = []
    for done, found in enumerate(current_ranks().in_turn(len(jobs), scored), start=1):
        rows += found
        if progress is not None:
            progress(done * len(methods), len(jobs) * len(methods))
    return rows


def _take(
    methods: Sequence[Method],
    poses: Mapping[str, Any],
    health: Mapping[str, Health | None],
    state: State,
    index: int,
) -> Taken:
    """Render one shot with every method."""
    shot = state.shots[index]
    with torch.no_grad():
        photos = {m.name: m.draw(poses[m.name], shot.camera).cpu() for m in methods}
    unseen = {
        name: None if one is None else one.shows_unseen(shot.camera, photos[name].alpha)
        for name, one in health.items()
    }
    return Taken(
        state=state.name,
        view=shot.view.name,
        index=index,
        rgba=shot.view.rgba() if state.has_truth else None,
        depth=None if shot.depth is None else shot.depth(),
        photos=photos,
        camera=shot.camera,
        health=health,
        unseen=unseen,
        valid=shot.view.valid() if state.has_truth else None,
    )


def _score(
    methods: Sequence[Method],
    taken: Taken,
    state: State,
    protocols: Sequence[Protocol],
    perceptual: Perceptual | None,
) -> list[ImageRow]:
    """One row per method and protocol."""
    rows: list[ImageRow] = []
    for method in methods:
        photo, health = taken.photos[method.name], taken.health[method.name]
        own = NO_HEALTH if health is None else health.row(taken.unseen[method.name], photo.alpha)
        geometry: Mapping[str, Value] = {}
        if taken.rgba is not None:
            geometry = _geometry(photo, taken.rgba, taken, state, method.tells)
        for protocol in protocols:
            images: Mapping[str, Value] = {}
            if taken.rgba is not None:
                valid = None if taken.valid is None else taken.valid.numpy()
                images = measure(protocol, photo.rgb, taken.rgba, perceptual, valid).row()
            row = ImageRow(
                method=method.name,
                state=taken.state,
                kind=state.kind,
                protocol=protocol.name,
                view=taken.view,
                scores={**images, **geometry, **own},
            )
            rows.append(row)
    return rows


def _check_names(methods: Sequence[Method]) -> None:
    names = [method.name for method in methods]
    if not names or len({*names}) < len(names):
        raise InputError(
            "methods to compare: expected at least one and no name twice, got "
            f"{', '.join(names) or 'none'}"
        )


def _geometry(
    photo: Image, rgba: Tensor, taken: Taken, state: State, tells: Tells
) -> Mapping[str, Value]:
    """Geometry metrics; without a true shape, or depth, only those that need the opacity alone."""
    alpha, size = rgba[..., 3], state.object_size
    if tells == "depth" and taken.depth is not None and size is not None:
        truth = TrueGeometry(alpha=alpha, depth=taken.depth, object_size=size)
        return measure_geometry(photo.alpha, photo.depth, truth).row()
    if tells == "colour" or not state.shots[taken.index].view.has_alpha:
        return _NO_GEOMETRY
    # No pixel has a true depth: only coverage is judged, and nothing may claim more than that.
    unknown = torch.full_like(alpha, torch.inf)
    truth = TrueGeometry(alpha=alpha, depth=unknown, object_size=1.0)
    drawn = torch.nan_to_num(photo.depth, nan=0.0, posinf=0.0, neginf=0.0)
    scores = measure_geometry(photo.alpha, drawn, truth)
    return replace(scores, hole_rate=None, depth_off_rate=None).row()


_NO_GEOMETRY: Mapping[str, Value] = dict.fromkeys(
    GeometryScores(
        hole_rate=None,
        see_through_rate=None,
        depth_off_rate=None,
        depth_error=None,
        depth_error_relative=None,
        spill=None,
        spill_to_object=None,
        solid_pixels=0,
        empty_pixels=0,
    ).row()
)


def mean(values: Sequence[Value]) -> float | None:
    """Mean of the values that are there; None when none is. Infinity is shown, not hidden."""
    known = [float(value) for value in values if value is not None]
    return float(np.mean(known)) if known else None
