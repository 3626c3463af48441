"""The methods that a run is compared by: it and what it was tuned from, with each kind of ray."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from torch import Tensor

from pcore.asset.asset import WHITE, Asset
from pcore.asset.content import LightName, RaysName
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.saving import load
from pcore.data.scene import Scene
from pcore.errors import CheckpointError
from pcore.evaluation.asset_method import AssetMethod, Draw, draw_asset
from pcore.evaluation.runner import ImageRow
from pcore.evaluation.states import State
from pcore.geometry.visibility import seen_by

UNTUNED, GAUSSIANS, TUNED_GAUSSIANS = "PAPR", "Gaussians", "Gaussians + P-CORE"
_LABELS = {"finetune": "P-CORE"}
_WAYS: tuple[tuple[RaysName, LightName], ...] = (
    ("plain", "baked"),
    ("aware", "baked"),
    ("aware", "still"),
)


def open_subject(path: Path | str, *, device: str = "cpu") -> Asset:
    """Open a run as true images show it, on white.

    Raises:
        CheckpointError: there is no run, or its model is missing or damaged.
    """
    return load(path, device=device).over(WHITE)


def baseline_of(asset: Asset, given: Path | None, *, device: str = "cpu") -> Asset | None:
    """Open the run to compare with: the one given, else the one that `asset` was tuned from.

    Raises:
        CheckpointError: it is not there or damaged.
    """
    if given is not None:
        return open_subject(given, device=device)
    base = asset.record.base
    if base is None:
        return None
    try:
        return open_subject(base, device=device)
    except CheckpointError as error:
        raise CheckpointError(
            f"{asset.path} was fine-tuned from {base}, which cannot be read: {error}; give that "
            "run with --baseline"
        ) from error


def label_of(asset: Asset) -> str:
    """What made it, in tables: `PAPR` or `Gaussians`; `P-CORE` was fine-tuned."""
    if isinstance(asset.content, GaussianContent):
        return TUNED_GAUSSIANS if asset.provenance.stage == "finetune" else GAUSSIANS
    return _LABELS.get(asset.provenance.stage, UNTUNED)


def apart(asset: Asset, among: Sequence[Asset]) -> str:
    """As many of the last names of its folder as tell it from the folders of others."""
    path = asset.path.resolve()
    others = [one.path.resolve() for one in among if one is not asset]
    names = path.parts[1:]
    ends = ("/".join(names[-count:]) for count in range(1, len(names) + 1))
    free = (end for end in ends if not any(one.as_posix().endswith(f"/{end}") for one in others))
    return next(free, path.as_posix())


def never_seen(points: Tensor, scene: Scene) -> Tensor:
    """(N,) bool, which canonical points (N, 3) no training view saw.

    Raises:
        SceneError: the training split is damaged.
    """
    return ~seen_by(points, [view.camera for view in scene.split("train")])


def plain_method(name: str, asset: Asset, scene: Scene) -> AssetMethod:
    """The method that draws a run with plain rays, as the paper does; Gaussians are carried."""
    rays: RaysName = "aware" if isinstance(asset.content, GaussianContent) else "plain"
    return AssetMethod(
        name=name, asset=asset.over(WHITE), rays=rays, unseen=never_seen(asset.points, scene)
    )


def methods_of(
    subjects: Sequence[Asset],
    scene: Scene,
    *,
    rays: str,
    light: LightName | None,
    take: Draw = draw_asset,
) -> list[AssetMethod]:
    """All methods of runs, the baseline first; equal names are told apart by their folders.

    Where a run has a light, aware rays come with it as well, unless the light is to be baked.

    Args:
        subjects: the runs, from `open_subject`.
        scene: their scene, whose training views say what was never seen.
        rays: "plain", "aware" or "both".
        light: as for `Asset.pose`.
        take: takes the pictures.

    Raises:
        CheckpointError: a light is damaged or belongs to other points.
        InputError: a light is asked for and there is none.
    """
    labels = [label_of(one) for one in subjects]
    found: list[AssetMethod] = []
    for asset, label in zip(subjects, labels, strict=True):
        unseen = never_seen(asset.points, scene)
        wanted = rays != "plain" and light != "baked"
        if wanted and light == "still":
            asset.pose(light="still")  # Says what is missing before any work is done.
        lit = wanted and asset.light is not None
        ways = _WAYS if lit else _WAYS[:2]
        same = [one for one, other in zip(subjects, labels, strict=True) if other == label]
        alike = f" ({apart(asset, same)})" if len(same) > 1 else ""
        found += [
            AssetMethod(
                name=_name(label, way, lamp) + alike,
                asset=asset,
                rays=way,
                light=lamp,
                unseen=unseen,
                take=take,
            )
            for way, lamp in ways
            if rays in ("both", way)
        ]
    # Plain rays of all runs, then aware ones, then those with a light: of the baseline first.
    return sorted(found, key=lambda method: (method.rays == "aware", method.light == "still"))


def _name(label: str, rays: RaysName, light: LightName) -> str:
    if rays == "plain":
        return label
    if label in (GAUSSIANS, TUNED_GAUSSIANS):
        # Shapes are carried by the affine map around each mean.
        name = label.replace(GAUSSIANS, "Gaussians affine")
    else:
        name = "aware" if label == UNTUNED else f"aware + {label}"
    return f"{name} + light" if light == "still" else name


_LISTED = 20


def mended_notes(
    rows: Sequence[ImageRow], methods: Sequence[AssetMethod], states: Sequence[State]
) -> list[str]:
    """Say at which points estimated frames had to be replaced, once per state and cloud."""
    named = {method.name: method for method in methods}
    places = {state.name: state for state in states}
    found: dict[tuple[str, int], dict[str, None]] = {}
    for row in rows:
        if row.scores["mended_frames"]:
            # Methods of one run share their frames.
            found.setdefault((row.state, id(named[row.method].asset)), {})[row.method] = None
    notes: list[str] = []
    for (state, _), names in found.items():
        # Moved once more: the rows hold numbers only, and few states come here.
        one = named[next(iter(names))]
        maps = one.pose(places[state]).local_maps
        numbers = [] if maps is None else maps.mended.tolist()
        notes.append(
            f"state {state}, {', '.join(names)}: {len(numbers)} of {len(one.asset):,} local frames "
            "were estimated inside out and replaced by a similarity, at points number "
            f"{', '.join(map(str, numbers[:_LISTED]))}{', ...' * (len(numbers) > _LISTED)}"
        )
    return notes
