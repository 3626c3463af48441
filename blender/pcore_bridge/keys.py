"""Keyframes out of values at every frame: as few as say the same; numpy only, no Blender."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Between = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""From two values and shares (S,) of the way to the values (S, ...) in between."""


def straight(first: np.ndarray, last: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Values on the straight way, as pcore goes between places."""
    way = shares.reshape(-1, *[1] * first.ndim)
    return (1 - way) * first + way * last


def turning(first: np.ndarray, last: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Unit quaternions on the shorter way round at an even speed (slerp), as pcore goes."""
    cosine = float(first @ last)
    other = -last if cosine < 0 else last
    angle = np.arccos(min(1.0, abs(cosine)))
    if np.sin(angle) < 1e-9:
        return np.broadcast_to(first, (len(shares), 4)).copy()
    ahead, back = np.sin(shares * angle), np.sin((1 - shares) * angle)
    return (back[:, None] * first + ahead[:, None] * other) / np.sin(angle)


def reduced(values: np.ndarray, tolerance: float, between: Between = straight) -> list[int]:
    """Numbers of the frames to keep, the first and last among them; one where nothing changes.

    Between them no frame is farther off than the tolerance (Ramer-Douglas-Peucker in time).

    Args:
        values: (F, ...) one for every frame, the last axis a place or a quaternion.
        tolerance: largest distance, of any of the places of a frame.
        between: how values go from key to key.
    """
    if _errors(values, np.broadcast_to(values[0], values.shape), between).max() <= tolerance:
        return [0]
    kept, spans = {0, len(values) - 1}, [(0, len(values) - 1)]
    while spans:
        start, end = spans.pop()
        if end - start < 2:
            continue
        shares = np.arange(1, end - start) / (end - start)
        inner = values[start + 1 : end]
        errors = _errors(inner, between(values[start], values[end], shares), between)
        worst = int(errors.argmax())
        if errors[worst] > tolerance:
            middle = start + 1 + worst
            kept.add(middle)
            spans += [(start, middle), (middle, end)]
    return sorted(kept)


def _errors(values: np.ndarray, others: np.ndarray, between: Between) -> np.ndarray:
    """Largest distance (F,) in every frame; q and -q are the same turn."""
    distance = np.linalg.norm(values - others, axis=-1)
    if between is turning:
        distance = np.minimum(distance, np.linalg.norm(values + others, axis=-1))
    return distance.reshape(len(values), -1).max(axis=1)
