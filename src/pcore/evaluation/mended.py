"""What is said of local frames that an estimate turned inside out."""

from __future__ import annotations

from collections.abc import Sequence

from pcore.evaluation.asset_method import AssetMethod
from pcore.evaluation.runner import ImageRow
from pcore.evaluation.states import State

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
