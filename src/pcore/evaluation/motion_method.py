"""PAPR-in-Motion's stages as methods: they learn each state from its own training photos."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path

from pcore.asset.asset import WHITE, Asset, Posed
from pcore.asset.content import RaysName
from pcore.asset.neural_points import NeuralPoints
from pcore.asset.saving import asset_of, neural_points_of
from pcore.capture.load import load_state
from pcore.data.scene import View
from pcore.errors import InputError, SceneError
from pcore.evaluation.contest import Contestant, Cost, Entry
from pcore.evaluation.contestants import Given, cost_of, seed_of, spent_on, suffixes
from pcore.evaluation.health import Health, health_of
from pcore.evaluation.picture_method import folder_of
from pcore.evaluation.runner import Tells
from pcore.evaluation.states import CANONICAL, SceneStates, State
from pcore.geometry.camera import Camera
from pcore.render.image import Image
from pcore.rivals.kept import Spent, kept_cost
from pcore.rivals.motion_stages import Motion, MotionConfig, kept_motion

STAGES = {
    1: "PAPR-in-Motion's stage 1 on our PAPR (supervised)",
    2: "PAPR-in-Motion's stages 1 and 2 on our PAPR (supervised)",
}
_RAYS: RaysName = "plain"


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionMethod:
    """A PAPR that has seen photos of the states.

    Attributes:
        name: for tables.
        asset: as it was trained on the start.
        stage: 1 moves the points, 2 also learns their looks anew.
        learn: gives what was learned of a state, and what both stages took together.
    """

    name: str
    asset: Asset
    stage: int
    learn: Callable[[State], tuple[Motion, Spent | None]] = field(repr=False)
    tells: Tells = "depth"

    def pose(self, state: State) -> tuple[Asset, Posed]:
        """The object that was learned from the state's photos.

        Raises:
            InputError: the state has no training photos.
        """
        if state.name == CANONICAL:
            return self.asset, self.asset.pose(rays=_RAYS)
        content = neural_points_of(self.asset, self.name)
        motion, _ = self.learn(state)
        papr, cloud = motion.stage(self.stage, content.papr, content.cloud)
        learned = asset_of(papr, cloud).over(WHITE)
        return learned, learned.pose(rays=_RAYS)

    def draw(self, posed: tuple[Asset, Posed], camera: Camera) -> Image:
        """Take a picture."""
        asset, at_rest = posed
        return asset.render(at_rest, camera)

    def health(self, posed: tuple[Asset, Posed], state: State) -> Health:
        """Diagnose the points that were learned."""
        del state
        return health_of(self.asset.points, posed[1].points, None)

    def cost(self, state: State) -> Cost:
        """What the training of the object and the stages took; no time where nothing was learned.

        At rest there is nothing to learn, and a mean over states is to be that of those learned.
        """
        first, spent = spent_on(self.asset), None
        if state.name != CANONICAL:
            _, spent = self.learn(state)
        if spent is None:
            return cost_of(self.asset, None)
        # Where nobody wrote down what the object took, the sum is not known either.
        total = None if first is None else first.seconds + spent.seconds
        return replace(cost_of(self.asset, None), seconds=total, megabytes=spent.megabytes)


def motion_entries(
    runs: Sequence[Given], places: SceneStates, folder: Path, config: MotionConfig
) -> list[Entry]:
    """Both stages for every run of points that was not fine-tuned."""
    entries: list[Entry] = []
    for run, suffix in zip(runs, suffixes(runs), strict=True):
        asset = run.asset
        if asset.record.stage != "pretrain" or not isinstance(asset.content, NeuralPoints):
            continue
        name = asset.path.resolve().name

        @cache
        def learn(state: State, run: Given = run, name: str = name) -> tuple[Motion, Spent | None]:
            content = neural_points_of(run.asset, name)
            # Another training in the same folder, other steps or photos: learned anew.
            depends = repr((run.stamp, config, places.factor)).encode()
            tag = f"{folder_of(state.name)}-{hashlib.sha256(depends).hexdigest()[:12]}"
            path = folder / f"motion-{name}-{tag}.safetensors"
            views = end_views(places, state.name)
            make = partial(kept_motion, path, content.papr, content.cloud, views, config)
            return kept_cost(path.with_suffix(".json"), make)

        for number, title in STAGES.items():
            named = title + suffix
            method = MotionMethod(name=named, asset=asset, stage=number, learn=learn)
            contestant = Contestant(method=method, cost_in=method.cost)
            entries.append(
                Entry(
                    name=named,
                    setting="given",
                    seed=seed_of(asset),
                    stamp=[run.stamp, config.steps],
                    make=lambda contestant=contestant: contestant,
                    learns=True,
                )
            )
    return entries


def end_views(places: SceneStates, state: str) -> tuple[View, ...]:
    """Training photos of a state.

    Raises:
        InputError: there are none.
    """
    try:
        return load_state(places.path, state, factor=places.factor).split("train")
    except SceneError as error:
        raise InputError(
            f"state {state}: expected training photos of it, from which PAPR-in-Motion learns, in "
            f"{places.path / folder_of(state)}, got none ({error})"
        ) from error


def has_end_views(places: SceneStates, states: Sequence[State]) -> bool:
    """Whether any of the states has training photos."""
    for state in states:
        try:
            end_views(places, state.name)
        except InputError:
            continue
        return True
    return False
