"""The poses of a moving object, one state after the other, as an edit with keyframes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pcore.asset.asset import Asset
from pcore.asset.posing import EditLike
from pcore.data.scene import View
from pcore.editing.animation import Animation
from pcore.errors import InputError
from pcore.fitting.fit_config import FitConfig
from pcore.fitting.fitted_edit import keyframed
from pcore.fitting.pose_fit import PoseFit, Progress, fit_pose
from pcore.fitting.shown_object import Shown


@dataclass(frozen=True, kw_only=True, eq=False)
class SequenceFit:
    """What a fit of several states found.

    Attributes:
        animation: edit with keyframes at the times of the states; between them places, axes and
            angles of the handles go straight.
        fits: that of every state.
    """

    animation: Animation
    fits: tuple[PoseFit, ...]


def fit_sequence(
    asset: Asset,
    states: Sequence[Sequence[View]],
    config: FitConfig | None = None,
    *,
    times: Sequence[float] | None = None,
    start: EditLike | None = None,
    shown: Shown | None = None,
    progress: Progress | None = None,
    keep: Callable[[Animation], None] | None = None,
) -> SequenceFit:
    """Find how an object is posed in several states; each starts from the one before.

    Args:
        asset: the object.
        states: photos of each, in the order of time.
        config: None takes the defaults.
        times: of the states, increasing; None is evenly from 0 to 1.
        start: edit to start the first one from; None is the rest state.
        shown: see `fit_pose`.
        progress: told (steps done, steps in all) of all states.
        keep: given the keyframes so far after each state from the second on.

    Raises:
        InputError: as `fit_pose`, naming the state; or times that do not fit.
        EditError: a start that does not fit the object.
    """
    config = config or FitConfig()
    count = len(states)
    if count < 2:
        raise InputError(f"sequence: expected at least two states, got {count}; use fit_pose")
    when = [k / (count - 1) for k in range(count)] if times is None else list(times)
    check_times(when, count)
    shown = shown or Shown.of(asset)
    fits: list[PoseFit] = []
    for number, views in enumerate(states):
        before = number * config.steps

        def tell(done: int, _: int, before: int = before) -> None:
            if progress is not None:
                progress(before + done, count * config.steps)

        try:
            found = fit_pose(asset, views, config, start=start, shown=shown, progress=tell)
        except InputError as error:
            raise InputError(f"state {number + 1} of {count}: {error}") from error
        fits.append(found)
        start = found.edit
        if keep is not None and number > 0:
            keep(keyframed([fit.edit for fit in fits], when[: number + 1]))
    animation = keyframed([fit.edit for fit in fits], when)
    return SequenceFit(animation=animation, fits=tuple(fits))


def check_times(times: Sequence[float], count: int) -> None:
    """Raise InputError unless there are so many times, in increasing order."""
    pairs = zip(times, list(times)[1:], strict=False)
    if len(times) != count or any(not first < second for first, second in pairs):
        raise InputError(f"times: expected {count} numbers in increasing order, got {list(times)}")
