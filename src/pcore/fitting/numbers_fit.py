"""Free numbers of an edit file, found from photos of a deformed state."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize

from pcore.asset.asset import Asset
from pcore.data.scene import View
from pcore.editing.reading import read_edit_file
from pcore.editing.script import EditScript, parse_edit
from pcore.errors import EditError, InputError
from pcore.fitting.agreement import agreement, check_same_object
from pcore.fitting.fit_photos import Photo, photos_of
from pcore.fitting.fitter import picture_loss
from pcore.fitting.pose_fit import PoseFit, Progress
from pcore.fitting.shown_object import Shown
from pcore.geometry.point_cloud import size_of

_DEGREES = 20.0
_SHARE = 0.1
_PIXELS = (13, 50, 100)
_TRIES = 40
"""Edits that are tried for every free number, at each size of pictures."""
_REFUSED = 1e6
"""Error of what folds space, or is no edit; finite, since the simplex takes differences."""


def fit_numbers(
    asset: Asset,
    edit: Path | str | Mapping[str, Any],
    free: Sequence[str],
    views: Sequence[View],
    *,
    silhouettes: bool = False,
    shown: Shown | None = None,
    progress: Progress | None = None,
) -> PoseFit:
    """Find numbers of an edit for which the object looks like photos; all else stays as it is.

    The simplex of Nelder and Mead (1965) at three sizes of pictures: edits of any type, which need
    no gradients. Meant for up to ten numbers.

    Args:
        asset: the object.
        edit: a file without keyframes, or its content; its numbers are where the search begins.
        free: names such as `edits.0.angle_deg` or `edits.0.handles.1.to.2`; edits from 0.
        views: photos with masks.
        silhouettes: compare outlines only.
        shown: see `fit_pose`.
        progress: told (edits tried, edits at most).

    Raises:
        EditError: the edit does not fit the object as it stands.
        InputError: a name that is no number of the edit, or photos as in `fit_pose`.
    """
    shown = shown or Shown.of(asset)
    folder = None if isinstance(edit, Mapping) else Path(edit).parent
    data = dict(edit) if isinstance(edit, Mapping) else read_edit_file(Path(edit))
    numbers = _Numbers(
        data=data, paths=tuple(tuple(name.split(".")) for name in free), folder=folder
    )
    values = numbers.start()
    photos = photos_of(views, shown.gaussians.means.device)
    finest = [photo.at_most(_PIXELS[-1]) for photo in photos]
    begun = numbers.script(values)
    before = agreement(asset, asset.pose(begun), finest, silhouettes=silhouettes)
    steps = numbers.steps(size_of(asset.points))
    tried, most = 0, _TRIES * len(values) * len(_PIXELS)

    def tell() -> None:
        nonlocal tried
        tried += 1
        if progress is not None:
            progress(min(tried, most), most)

    for pixels in _PIXELS:
        small = [photo.at_most(pixels) for photo in photos]
        error = _error_of(shown, numbers, small, silhouettes, tell)
        values = _least(error, values, steps)
        steps = steps / 4
    result = numbers.script(values)
    after = agreement(asset, asset.pose(result), finest, silhouettes=silhouettes)
    if after.error > before.error:
        result, after = begun, before
    check_same_object(after, silhouettes=silhouettes)
    return PoseFit(edit=result, before=before, after=after)


Values = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Numbers:
    """The free numbers of an edit: parsed JSON, where they stand in it, and its folder."""

    data: Any
    paths: tuple[tuple[str, ...], ...]
    folder: Path | None

    def start(self) -> Values:
        return np.array([_number(self.data, path) for path in self.paths])

    def steps(self, reach: float) -> Values:
        """How far each is moved at first."""
        pairs = zip(self.paths, self.start().tolist(), strict=True)
        return np.array([_step(path[-1], value, reach) for path, value in pairs])

    def script(self, values: Values) -> EditScript:
        return parse_edit(_with(self.data, self.paths, values), folder=self.folder)


def _error_of(
    shown: Shown,
    numbers: _Numbers,
    photos: Sequence[Photo],
    silhouettes: bool,
    tell: Callable[[], None],
) -> Callable[[Values], float]:
    white = shown.gaussians.means.new_ones(3)

    @torch.no_grad()
    def error(values: Values) -> float:
        tell()
        try:
            posed = shown.look(shown.asset.pose(numbers.script(values)))
        except EditError:
            return _REFUSED
        footprint = shown.footprint
        return float(
            picture_loss(posed, photos, white, footprint=footprint, silhouettes=silhouettes)
        )

    return error


def _least(error: Callable[[Values], float], values: Values, steps: Values) -> Values:
    """Values of the least error that the simplex finds from here."""
    count = len(values)
    options = {
        "initial_simplex": np.vstack([np.zeros(count), np.eye(count)]),
        "maxfev": _TRIES * count,
        "xatol": 1e-3,
        "fatol": 1e-6,
    }

    def shifted(shares: Values) -> float:
        return error(values + steps * shares)

    found = minimize(shifted, np.zeros(count), method="Nelder-Mead", options=options)
    return values + steps * found.x


def _step(name: str, value: float, reach: float) -> float:
    """How far a number is moved at first: degrees, or a share of it or of the object."""
    if name.endswith("_deg"):
        return _DEGREES
    return _SHARE * (abs(value) if value else reach)


def _key(holder: Any, name: str) -> Any:
    """Key or index of a part of parsed JSON; None where it has none of that name."""
    if isinstance(holder, dict):
        return name if name in holder else None
    if isinstance(holder, list) and name.isdecimal():
        return int(name) if int(name) < len(cast("list[Any]", holder)) else None
    return None


def _number(data: Any, path: Sequence[str]) -> float:
    part = data
    for name in path:
        key = _key(part, name)
        if key is None:
            part = None
            break
        part = part[key]
    if isinstance(part, bool) or not isinstance(part, (int, float)):
        raise InputError(
            f"free number {'.'.join(path)!r}: expected the name of a number that stands in the "
            "edit file, such as edits.0.angle_deg with edits from 0, got "
            f"{'no such place' if part is None else type(part).__name__}"
        )
    return float(part)


def _with(data: Any, paths: Sequence[Sequence[str]], values: NDArray[np.float64]) -> Any:
    changed = copy.deepcopy(data)
    for path, value in zip(paths, values, strict=True):
        holder = changed
        for name in path[:-1]:
            holder = holder[_key(holder, name)]
        holder[_key(holder, path[-1])] = float(value)
    return changed
