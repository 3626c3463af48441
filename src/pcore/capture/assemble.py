"""Make a scene of posed photos: sizes, lenses, masks, splits, points in pixels of the views."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from pcore.capture.opened import Opened, UnusableError, open_photo
from pcore.capture.photos import HELD_OUT, Capture, RawPoints, natural_key
from pcore.data.images import AlphaOfSplit, ImageCache
from pcore.data.poses import are_far, check_poses
from pcore.data.scene import Scene, Skipped, Split, SplitsOnDemand
from pcore.data.sparse import Sightings, SparsePoints
from pcore.errors import SceneError

_LEAST = 2
_NAMED = 3


def scene_of(capture: Capture, *, root: Path, given: Path, factor: int, cache: ImageCache) -> Scene:
    """Open the headers of all photos and make views of them.

    Photos that are missing, damaged, of another shape than the model's or without a finite pose are
    skipped and listed; fewer than two that are left are refused.

    Args:
        capture: what the files of a layout say.
        root: folder of the capture.
        given: what the user gave: the folder, or what chooses a layout in it.
        factor: whole number by which pictures are down-scaled; up to `factor - 1` columns at the
            right and rows below that are left over are cut off.
        cache: keeps decoded images.

    Raises:
        SceneError: too few photos are left, or poses that no photos of one object can have.
    """
    taken, skipped = _take(capture, factor // capture.shrunk, cache)
    if len(taken) < _LEAST:
        raise SceneError(_too_few(capture, taken, skipped))
    taken = _named(sorted(taken, key=lambda one: natural_key(one.photo.name)))
    views = [one.view for one in taken]
    poses = torch.stack([one.photo.world_from_camera for one in taken])
    cameras, names = [view.camera for view in views], [view.name for view in views]
    notes = [*capture.notes, *_counted(taken), check_poses(poses, cameras, names, capture.where)]
    if skipped:
        notes.append(_say_skipped(skipped, len(capture.photos) + len(capture.skipped)))
    splits = _splits(capture, taken, tuple(note for note in notes if note))
    return Scene(
        name=root.name,
        root=root,
        views=SplitsOnDemand({name: _ready(split) for name, split in splits.items()}),
        folder=given,
        factor=factor,
        layout=capture.layout,
        sparse=None if capture.sparse is None else _sparse(capture.sparse, taken),
        region=capture.region,
        skipped=tuple(skipped),
    )


def _take(capture: Capture, factor: int, cache: ImageCache) -> tuple[list[Opened], list[Skipped]]:
    taken: list[Opened] = []
    skipped = list(capture.skipped)
    known: set[str] = set()
    far = are_far([photo.world_from_camera for photo in capture.photos])
    for row, photo in enumerate(capture.photos):
        try:
            if photo.name in known:
                raise UnusableError("named twice; the first is used")
            known.add(photo.name)
            taken.append(open_photo(row, photo, factor, cache, far=far))
        except UnusableError as problem:
            skipped.append(Skipped(name=photo.name, reason=str(problem)))
    return taken, skipped


def _named(taken: Sequence[Opened]) -> list[Opened]:
    """Views with unique names that are safe as file names: the stem, with folders where needed."""
    paths = [Path(one.photo.name.replace("\\", "/")) for one in taken]
    short = Counter(_safe(path.stem) for path in paths)
    names = [
        _safe(path.stem) if short[_safe(path.stem)] == 1 else _safe(path.with_suffix("").as_posix())
        for path in paths
    ]
    counts = Counter(names)
    return [
        replace(
            one,
            view=replace(one.view, name=name if counts[name] == 1 else f"{name}_{index:04d}"),
        )
        for index, (one, name) in enumerate(zip(taken, names, strict=True))
    ]


def _safe(name: str) -> str:
    return re.sub(r"[^\w.-]", "_", name).lstrip("._") or "photo"


def _splits(capture: Capture, taken: Sequence[Opened], notes: tuple[str, ...]) -> dict[str, Split]:
    if capture.splits is None:
        views = {
            "train": [one.view for index, one in enumerate(taken) if index % HELD_OUT],
            "test": [one.view for one in taken[::HELD_OUT]],
        }
    else:
        views = {
            name: [one.view for one in taken if one.photo.name in set(names)]
            for name, names in capture.splits.items()
        }
    if not views.get("train"):
        raise SceneError(
            f"{capture.where}: none of the {len(taken)} photos that can be used is in the split "
            "'train'; put more photos there, or remove the splits from the capture's files"
        )
    return {
        name: _masked(Split(views=tuple(chosen), notes=notes))
        for name, chosen in views.items()
        if chosen
    }


def _masked(split: Split) -> Split:
    """Let the alpha of all pictures of a split tell together whether it is a mask."""
    alpha = AlphaOfSplit()
    views = tuple(replace(v, image=replace(v.image, alpha=alpha)) for v in split.views)
    alpha.sources = [view.image for view in views]
    return replace(split, views=views)


def _ready(split: Split):  # noqa: ANN202
    return lambda: split


def _sparse(raw: RawPoints, taken: Sequence[Opened]) -> SparsePoints:
    sightings = None
    if raw.points is not None and raw.photos is not None and raw.places is not None:
        points: list[Tensor] = []
        views: list[Tensor] = []
        places: list[Tensor] = []
        order = raw.photos.argsort(stable=True)
        starts = torch.searchsorted(
            raw.photos[order], torch.tensor([[one.row, one.row + 1] for one in taken])
        )
        for index, (one, (first, last)) in enumerate(zip(taken, starts.tolist(), strict=True)):
            chosen = order[first:last]
            points.append(raw.points[chosen])
            views.append(torch.full((len(chosen),), index))
            places.append(_in_view(raw.places[chosen], one))
        sightings = Sightings(
            names=tuple(one.view.name for one in taken),
            points=torch.cat(points),
            views=torch.cat(views),
            places=torch.cat(places).float(),
        )
    return SparsePoints(
        positions=raw.positions.float(),
        colors=raw.colors,
        errors=raw.errors,
        seen_by=raw.seen_by,
        sightings=sightings,
    )


def _in_view(places: Tensor, one: Opened) -> Tensor:
    """Places (K, 2) in pixels of the model -> pixels of the straight, down-scaled view."""
    lens, said = one.lens, one.photo.lens
    scale = torch.tensor([lens.fx / said.fx, lens.fy / said.fy], dtype=places.dtype)
    straight = places * scale if lens.is_straight else lens.straightened(places * scale)
    return straight / one.view.image.factor


def _counted(taken: Sequence[Opened]) -> list[str]:
    counts = Counter(note for one in taken for note in one.notes)
    return [f"{count} of {len(taken)} photos {note}" for note, count in counts.items()]


def _say_skipped(skipped: Sequence[Skipped], count: int) -> str:
    reasons = Counter(one.reason for one in skipped)
    said = [
        f"{_some([one.name for one in skipped if one.reason == reason])} ({reason})"
        for reason in list(reasons)[:_NAMED]
    ]
    more = f"; and {len(reasons) - _NAMED} other reasons" if len(reasons) > _NAMED else ""
    return f"{len(skipped)} of {count} photos are not used: {'; '.join(said)}{more}"


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:_NAMED]) + f" and {len(names) - _NAMED} more" * (len(names) > _NAMED)


def _too_few(capture: Capture, taken: Sequence[Opened], skipped: Sequence[Skipped]) -> str:
    said = (
        f". {_say_skipped(skipped, len(capture.photos) + len(capture.skipped))}" if skipped else ""
    )
    return (
        f"{capture.where}: expected at least {_LEAST} photos with poses, got {len(taken)}; take or "
        f"pose more{said}"
    )
