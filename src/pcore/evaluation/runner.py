"""Take every picture of every state with every method, and score it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from pcore.asset.asset import Asset, Posed
from pcore.asset.content import LightName, MovedPoints, RaysName
from pcore.errors import EditError, InputError
from pcore.evaluation.health import Health, health_of
from pcore.evaluation.protocol import PAPR, STANDARD, Perceptual, Protocol, measure
from pcore.evaluation.states import Kind, State
from pcore.geometry.camera import Camera
from pcore.metrics.geometry_metrics import GeometryScores, TrueGeometry, measure_geometry
from pcore.render.image import Image

Value = float | int | None
Progress = Callable[[int, int], None]


Draw = Callable[[Asset, Posed, Camera], Image]
"""Takes a picture of a posed asset."""


def draw_asset(asset: Asset, posed: Posed, camera: Camera) -> Image:
    """Take it as `Asset.render` does."""
    return asset.render(posed, camera)


@dataclass(frozen=True, kw_only=True, eq=False)
class Method:
    """One of the methods that are compared.

    Attributes:
        name: for tables; unique among the methods.
        asset: what is drawn, on white.
        rays: how deformed states are seen.
        light: what the light does while points move; "still" needs aware rays.
        unseen: (N,) bool, which points no training view saw; None where that is not known.
    """

    name: str
    asset: Asset
    rays: RaysName
    light: LightName = "baked"
    unseen: Tensor | None = None


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
        health: method -> what the state does to its points.
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
    health: Mapping[str, Health]
    unseen: Mapping[str, Tensor | None]
    valid: Tensor | None = None


def evaluate(
    methods: Sequence[Method],
    states: Sequence[State],
    *,
    draw: Draw = draw_asset,
    protocols: Sequence[Protocol] = (PAPR, STANDARD),
    perceptual: Perceptual | None = None,
    progress: Progress | None = None,
    show: Callable[[Taken], None] | None = None,
) -> list[ImageRow]:
    """Score methods on states of a scene.

    Args:
        methods: at least one, names unique.
        states: from `SceneStates.select`.
        draw: takes the pictures.
        protocols: ways to score images; every picture is taken once and scored by each.
        perceptual: LPIPS networks; None leaves LPIPS out.
        progress: called with (pictures done, pictures in all).
        show: called with the pictures of every shot as soon as they are taken; they are not kept.

    Returns:
        One row per picture and protocol: states, views, methods, protocols from slow to fast.

    Raises:
        InputError: no method, names that repeat, or a picture that cannot be measured.
        EditError: a state folds space where a method draws with aware rays.
    """
    _check_names(methods)
    total = len(methods) * sum(len(state.shots) for state in states)
    rows: list[ImageRow] = []
    done = 0
    # All poses first: a state that cannot be drawn must not cost the pictures of those before.
    carried = [carry(methods, state) for state in states]
    for state, poses in zip(states, carried, strict=True):
        maps = {name: one.local_maps for name, one in poses.items()}
        mended = {name: None if one is None else len(one.mended) for name, one in maps.items()}
        health = _health(methods, poses, state)
        for index in range(len(state.shots)):
            taken = _take(methods, poses, health, state, index, draw)
            rows += _score(taken, state, protocols, perceptual, mended)
            done += len(methods)
            if progress is not None:
                progress(done, total)
            if show is not None:
                show(taken)
    return rows


def _take(
    methods: Sequence[Method],
    poses: Mapping[str, Posed],
    health: Mapping[str, Health],
    state: State,
    index: int,
    draw: Draw,
) -> Taken:
    """Render one shot with every method."""
    shot = state.shots[index]
    with torch.no_grad():
        photos = {m.name: draw(m.asset, poses[m.name], shot.camera).cpu() for m in methods}
    return Taken(
        state=state.name,
        view=shot.view.name,
        index=index,
        rgba=shot.view.rgba() if state.has_truth else None,
        depth=None if shot.depth is None else shot.depth(),
        photos=photos,
        camera=shot.camera,
        health=health,
        unseen={n: health[n].shows_unseen(shot.camera, p.alpha) for n, p in photos.items()},
        valid=shot.view.valid() if state.has_truth else None,
    )


def _score(
    taken: Taken,
    state: State,
    protocols: Sequence[Protocol],
    perceptual: Perceptual | None,
    mended: Mapping[str, Value],
) -> list[ImageRow]:
    """One row per method and protocol."""
    rows: list[ImageRow] = []
    for name, photo in taken.photos.items():
        own = taken.health[name].row(taken.unseen[name], photo.alpha)
        geometry = {} if taken.rgba is None else _geometry(photo, taken.rgba, taken, state)
        for protocol in protocols:
            images: Mapping[str, Value] = {}
            if taken.rgba is not None:
                valid = None if taken.valid is None else taken.valid.numpy()
                images = measure(protocol, photo.rgb, taken.rgba, perceptual, valid).row()
            row = ImageRow(
                method=name,
                state=taken.state,
                kind=state.kind,
                protocol=protocol.name,
                view=taken.view,
                scores={**images, **geometry, "mended_frames": mended[name], **own},
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


def carry(methods: Sequence[Method], state: State) -> dict[str, Posed]:
    """Move every method's asset to the state; methods of one run share the work.

    All methods are measured by one kind of depth, that of the surface where a run knows it,
    whatever their rays and their light.
    """
    motions: dict[int, tuple[MovedPoints, EditError | None]] = {}
    poses: dict[str, Posed] = {}
    for method in methods:
        asset, key = method.asset, id(method.asset)
        if key not in motions:
            motions[key] = _moved(state, asset.points.detach().cpu())
        motion, error = motions[key]
        if error is not None and method.rays == "aware":
            raise EditError(f"state {state.name}: {error}; plain rays can draw it") from error
        poses[method.name] = asset.pose(motion, rays=method.rays, light=method.light)
    return poses


def _moved(state: State, rest: Tensor) -> tuple[MovedPoints, EditError | None]:
    """Where a state takes canonical points (N, 3), and why there may be no local maps."""
    positions = state.move(rest)
    try:
        maps = state.local_maps(rest, positions)
    except EditError as error:
        return MovedPoints(positions=positions, world=state.world), error
    return MovedPoints(positions=positions, local_maps=maps, world=state.world), None


def _health(
    methods: Sequence[Method], poses: Mapping[str, Posed], state: State
) -> dict[str, Health]:
    """Diagnose every method's points; methods of one run share the work."""
    known: dict[int, Health] = {}
    for method in methods:
        if id(method.asset) not in known:
            rest, moved = method.asset.points, poses[method.name].points
            handles = () if state.handles is None else state.handles(rest.detach().cpu())
            known[id(method.asset)] = health_of(rest, moved, method.unseen, handles)
    return {method.name: known[id(method.asset)] for method in methods}


def _geometry(photo: Image, rgba: Tensor, taken: Taken, state: State) -> Mapping[str, Value]:
    """Geometry metrics; without a true shape only those that need the opacity alone."""
    alpha, size = rgba[..., 3], state.object_size
    if taken.depth is not None and size is not None:
        truth = TrueGeometry(alpha=alpha, depth=taken.depth, object_size=size)
        return measure_geometry(photo.alpha, photo.depth, truth).row()
    if not state.shots[taken.index].view.has_alpha:
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
