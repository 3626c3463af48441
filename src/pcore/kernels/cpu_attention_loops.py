"""What is done to the rows of a chunk of pairs between two matrix products, by numba.

Arrays: `ids` (P,) pairs as indices into (R k), `starts` (rays + 1,) where the pairs of each ray of
the chunk begin, `points` (R k,) the point of every pair.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numba import prange

from pcore.kernels.networks import EPSILON

_SUMS = {"reassoc", "contract"}
"""Sums may be reordered, so that they are vectorised; infinities and NaN keep their meaning."""
_BLOCK = 64
"""Rows that one thread sums up by itself."""


@numba.njit(cache=True, parallel=True, fastmath=_SUMS)
def key_rows(
    own: np.ndarray,
    waves: np.ndarray,
    points: np.ndarray,
    ids: np.ndarray,
    rows: np.ndarray,
    scales: np.ndarray,
) -> None:
    """Gather and standardise the key's input (P, O + V); 1 / std goes to scales (P,)."""
    first, size = own.shape[1], rows.shape[1]
    for pair in prange(len(ids)):
        row, point, wave = rows[pair], own[points[ids[pair]]], waves[ids[pair]]
        total = np.float32(0.0)
        for column in range(first):
            row[column] = point[column]
            total += point[column]
        for column in range(size - first):
            row[first + column] = wave[column]
            total += wave[column]
        mean = total / np.float32(size)
        squares = np.float32(0.0)
        for column in range(size):
            row[column] -= mean
            squares += row[column] * row[column]
        scale = np.float32(1.0) / np.sqrt(squares / np.float32(size) + np.float32(EPSILON))
        for column in range(size):
            row[column] *= scale
        scales[pair] = scale


@numba.njit(cache=True, parallel=True, fastmath=_SUMS)
def key_rows_backward(
    upstream: np.ndarray,
    rows: np.ndarray,
    scales: np.ndarray,
    ids: np.ndarray,
    to_waves: np.ndarray,
) -> None:
    """From the gradient of the standardised rows to that of the waves, at `ids`."""
    size = rows.shape[1]
    first = size - to_waves.shape[1]
    for pair in prange(len(ids)):
        gradient, row, out = upstream[pair], rows[pair], to_waves[ids[pair]]
        mean, along = np.float32(0.0), np.float32(0.0)
        for column in range(size):
            mean += gradient[column]
            along += gradient[column] * row[column]
        mean /= np.float32(size)
        along /= np.float32(size)
        for column in range(size - first):
            off = gradient[first + column] - mean - row[first + column] * along
            out[column] = scales[pair] * off


@numba.njit(cache=True, parallel=True)
def value_rows(
    waves: np.ndarray, features: np.ndarray, points: np.ndarray, ids: np.ndarray, rows: np.ndarray
) -> None:
    """Gather the value's input (P, V + F)."""
    first = waves.shape[1]
    for pair in prange(len(ids)):
        row, wave, feature = rows[pair], waves[ids[pair]], features[points[ids[pair]]]
        for column in range(first):
            row[column] = wave[column]
        for column in range(len(feature)):
            row[first + column] = feature[column]


@numba.njit(cache=True)
def value_rows_backward(
    upstream: np.ndarray,
    points: np.ndarray,
    ids: np.ndarray,
    to_waves: np.ndarray,
    to_features: np.ndarray,
) -> None:
    """Scatter the gradient of the value's input; pairs share points, so one thread does it."""
    first = to_waves.shape[1]
    for pair in range(len(ids)):
        wave, feature = to_waves[ids[pair]], to_features[points[ids[pair]]]
        for column in range(first):
            wave[column] = upstream[pair, column]
        for column in range(len(feature)):
            feature[column] += upstream[pair, first + column]


@numba.njit(cache=True, parallel=True)
def activate(rows: np.ndarray, bias: np.ndarray, slope: np.float32) -> None:
    """Add the bias and apply a leaky ReLU in place; slope 1 is the identity."""
    for pair in prange(len(rows)):
        row = rows[pair]
        for column in range(row.shape[0]):
            x = row[column] + bias[column]
            row[column] = x if x > 0 else slope * x


@numba.njit(cache=True, parallel=True)
def activate_backward(
    upstream: np.ndarray, activated: np.ndarray, slope: np.float32, to_bias: np.ndarray
) -> None:
    """Turn the gradient of activated rows into that of the linear layer; add up the bias'."""
    count, width = upstream.shape
    blocks = (count + _BLOCK - 1) // _BLOCK
    sums = np.zeros((blocks, width), dtype=np.float32)
    for block in prange(blocks):
        for pair in range(block * _BLOCK, min(count, (block + 1) * _BLOCK)):
            for column in range(width):
                x = upstream[pair, column]
                x = x if activated[pair, column] > 0 else slope * x
                upstream[pair, column] = x
                sums[block, column] += x
    for block in range(blocks):
        for column in range(width):
            to_bias[column] += sums[block, column]


@numba.njit(cache=True, parallel=True, fastmath=_SUMS)
def scores(
    keys: np.ndarray,
    queries: np.ndarray,
    starts: np.ndarray,
    ids: np.ndarray,
    out: np.ndarray,
) -> None:
    """<query, standardise(key)> of the chunk's pairs, to `ids` of out."""
    size = keys.shape[1]
    for ray in prange(len(starts) - 1):
        query = queries[ray]
        total = np.float32(0.0)
        for column in range(size):
            total += query[column]
        for pair in range(starts[ray], starts[ray + 1]):
            mean, scale, along = _compare(keys[pair], query)
            out[ids[pair]] = scale * (along - mean * total)


@numba.njit(cache=True, fastmath=_SUMS)
def _compare(key: np.ndarray, query: np.ndarray) -> tuple[Any, Any, Any]:
    """Mean and 1 / std of a key, and its product with the query."""
    size = np.float32(len(key))
    total, along, squares = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for column in range(len(key)):
        total += key[column]
        along += key[column] * query[column]
    mean = total / size
    for column in range(len(key)):
        off = key[column] - mean
        squares += off * off
    return mean, np.float32(1.0) / np.sqrt(squares / size + np.float32(EPSILON)), along


@numba.njit(cache=True, parallel=True, fastmath=_SUMS)
def scores_backward(
    upstream: np.ndarray,
    keys: np.ndarray,
    queries: np.ndarray,
    starts: np.ndarray,
    ids: np.ndarray,
    to_queries: np.ndarray,
    to_keys: np.ndarray,
) -> None:
    """Gradients of the keys; those of the queries are added up."""
    size = np.float32(keys.shape[1])
    for ray in prange(len(starts) - 1):
        query, to_query = queries[ray], to_queries[ray]
        total = np.float32(0.0)
        for column in range(keys.shape[1]):
            total += query[column]
        for pair in range(starts[ray], starts[ray + 1]):
            key, gradient = keys[pair], upstream[ids[pair]]
            mean, scale, along = _compare(key, query)
            along = scale * (along - mean * total) / size
            for column in range(keys.shape[1]):
                standard = scale * (key[column] - mean)
                to_query[column] += gradient * standard
                off = query[column] - total / size - standard * along
                to_keys[pair, column] = gradient * scale * off


@numba.njit(cache=True, parallel=True)
def pool(
    hidden: np.ndarray, weights: np.ndarray, starts: np.ndarray, ids: np.ndarray, out: np.ndarray
) -> None:
    """Add the weighted rows of every ray to out (rays, width)."""
    for ray in prange(len(starts) - 1):
        for pair in range(starts[ray], starts[ray + 1]):
            weight = weights[ids[pair]]
            for column in range(hidden.shape[1]):
                out[ray, column] += weight * hidden[pair, column]


@numba.njit(cache=True, parallel=True, fastmath=_SUMS)
def pool_backward(
    upstream: np.ndarray,
    hidden: np.ndarray,
    weights: np.ndarray,
    starts: np.ndarray,
    ids: np.ndarray,
    to_weights: np.ndarray,
    to_hidden: np.ndarray,
) -> None:
    """Gradients of the weights, at `ids`, and of the rows."""
    for ray in prange(len(starts) - 1):
        for pair in range(starts[ray], starts[ray + 1]):
            weight, total = weights[ids[pair]], np.float32(0.0)
            for column in range(hidden.shape[1]):
                total += upstream[ray, column] * hidden[pair, column]
                to_hidden[pair, column] = weight * upstream[ray, column]
            to_weights[ids[pair]] = total
