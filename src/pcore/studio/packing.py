"""Recordings of splats as few bytes: quantised, compressed, made to fit a size.

Per moment and splat: 6 bytes of mean (16 bits over the box of all moments), 8 of shape (the
Cholesky factor of the covariance: its largest entry on a logarithmic scale, all six as shares of
it), 4 of turn where colours depend on the view, 1 of light. Once: opacity and harmonics, a byte
each. `page/viewer.js` reads them.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pcore.studio.recording import Moment, Recording

Array = NDArray[Any]

HIGHEST_DEGREE = 3
"""Of the harmonics that the page evaluates."""
_ENOUGH, _FEWEST = 12, 3
"""Moments that are kept before harmonics are given up, and before splats are."""
_GAIN = 32.0
"""Steps of a factor of the light per doubling."""
_LEVEL = 9
"""Of zlib."""
_LEAST = 1e-30


@dataclass(frozen=True, kw_only=True)
class Packed:
    """Compressed arrays and what is needed to read them.

    Attributes:
        head: numbers, and of every array its type, first byte and length.
        data: all arrays one after another, by zlib.
        notes: what had to be left out to make it fit, a sentence each.
    """

    head: dict[str, Any]
    data: bytes
    notes: tuple[str, ...] = ()


def pack(recording: Recording, limit: int) -> Packed:
    """Make a recording fit: by fewer moments, then fewer harmonics, then fewer splats.

    Args:
        recording: the splats.
        limit: most bytes of the data.
    """
    chosen = _with_degree(recording, min(_degree(recording), HIGHEST_DEGREE))
    packed = _packed(chosen)
    for step in (_ENOUGH, 1, 0, _FEWEST):
        if len(packed.data) <= limit:
            break
        if step in (0, 1):
            chosen = _with_degree(chosen, min(step, _degree(chosen)))
            packed = _packed(chosen)
        else:
            chosen, packed = _with_moments(chosen, packed, step, limit)
    while len(packed.data) > limit and len(chosen) > 1:
        kept = max(1, int(len(chosen) * 0.97 * limit / len(packed.data)))
        chosen = _largest(chosen, kept)
        packed = _packed(chosen)
    return replace(packed, notes=_notes(recording, chosen))


def _with_moments(
    chosen: Recording, packed: Packed, fewest: int, limit: int
) -> tuple[Recording, Packed]:
    """Leave out moments, evenly, until the rest fits or no more than the fewest are left."""
    while len(packed.data) > limit and len(chosen.moments) > fewest:
        kept = max(fewest, int(len(chosen.moments) * 0.97 * limit / len(packed.data)))
        places = torch.linspace(0, len(chosen.moments) - 1, kept).round().long()
        chosen = replace(chosen, moments=tuple(chosen.moments[int(k)] for k in places))
        packed = _packed(chosen)
    return chosen, packed


def _notes(recording: Recording, chosen: Recording) -> tuple[str, ...]:
    notes: list[str] = []
    if len(chosen.moments) < len(recording.moments):
        notes.append(
            f"{len(chosen.moments)} of {len(recording.moments)} moments, with steady motion "
            "between them, to fit the size"
        )
    if _degree(chosen) < _degree(recording):
        notes.append(f"colours with harmonics of degree {_degree(chosen)}, to fit the size")
    if len(chosen) < len(recording):
        notes.append(
            f"the {len(chosen):,} of {len(recording):,} splats that show most, to fit the size"
        )
    return tuple(notes)


def _degree(recording: Recording) -> int:
    return round(recording.sh.shape[1] ** 0.5) - 1


def _with_degree(recording: Recording, degree: int) -> Recording:
    """Leave out the harmonics above a degree."""
    return replace(recording, sh=recording.sh[:, : (degree + 1) ** 2])


def _largest(recording: Recording, count: int) -> Recording:
    """The splats with the most opacity times area at the first moment."""
    sizes = torch.linalg.eigvalsh(recording.moments[0].covariances)
    shown = recording.opacities * (sizes[:, 1] * sizes[:, 2]).clamp_min(0).sqrt()
    rows = shown.topk(count).indices.sort().values
    moments = (
        Moment(
            means=one.means[rows],
            covariances=one.covariances[rows],
            turns=one.turns[rows],
            gains=one.gains[rows],
        )
        for one in recording.moments
    )
    return replace(
        recording,
        moments=tuple(moments),
        opacities=recording.opacities[rows],
        body=recording.body[rows],
        sh=recording.sh[rows],
    )


def _packed(recording: Recording) -> Packed:
    moments, degree = recording.moments, _degree(recording)
    box, means = _means([one.means for one in moments])
    sizes, scales, factors = _shapes([one.covariances for one in moments])
    colors, first, others = _colors(recording.sh)
    arrays: dict[str, Array] = {
        "means": means,
        "scales": scales,
        "factors": factors,
        "gains": _gains([one.gains for one in moments]),
        "opacities": _bytes(recording.opacities * 255, np.uint8),
        "first": first,
        "others": others,
    }
    if degree > 0:
        turns = torch.stack([one.turns for one in moments]).mT
        arrays["turns"] = _bytes(turns * 127, np.int8)
    data, places = _joined(arrays)
    head = {
        "count": len(recording),
        "moments": len(moments),
        "degree": degree,
        "box": box,
        "sizes": sizes,
        "colors": colors,
        "gain": _GAIN,
        "variance": recording.footprint.variance,
        "antialiased": recording.footprint.antialiased,
        "background": list(recording.background),
        "arrays": places,
    }
    return Packed(head=head, data=zlib.compress(data, _LEVEL))


def _means(moments: Sequence[Tensor]) -> tuple[list[list[float]], Array]:
    """Corners of the box of all, and (T, 3, N) uint16."""
    means = torch.stack(list(moments)).double()
    low, high = means.amin(dim=(0, 1)), means.amax(dim=(0, 1))
    room = (high - low).clamp_min(_LEAST)
    return [low.tolist(), high.tolist()], _bytes(((means - low) / room * 65535).mT, np.uint16)


def _shapes(moments: Sequence[Tensor]) -> tuple[list[float], Array, Array]:
    """Range of the logarithms, (T, N) uint16 in it, (T, 6, N) int8 shares of the largest entry."""
    wide = torch.stack(list(moments)).double()
    # What rounding or a flattening edit left without a factor gets a thickness that nobody sees.
    most = wide.diagonal(dim1=-2, dim2=-1).amax(dim=-1).clamp_min(_LEAST)
    wide = wide + (1e-6 * most)[..., None, None] * torch.eye(3, dtype=wide.dtype)
    lower = torch.linalg.cholesky(wide)
    rows, columns = torch.tril_indices(3, 3)
    entries = lower[..., rows, columns]
    largest = entries.abs().amax(dim=-1)
    logs = largest.log()
    low, high = float(logs.min()), float(logs.max())
    scales = (logs - low) / max(high - low, 1e-9) * 65535
    shares = (entries / largest.unsqueeze(-1) * 127).mT
    return [low, high], _bytes(scales, np.uint16), _bytes(shares, np.int8)


def _colors(sh: Tensor) -> tuple[dict[str, Any], Array, Array]:
    """Ranges, (3, N) uint8 of the constant harmonic, (K - 1, 3, N) int8 of the others."""
    constant, rest = sh[:, 0], sh[:, 1:]
    low, high = float(constant.min()), float(constant.max())
    first = (constant - low) / max(high - low, 1e-9) * 255
    bands: list[Tensor] = []
    most: list[float] = []
    for degree in range(1, round(sh.shape[1] ** 0.5)):
        band = rest[:, degree * degree - 1 : (degree + 1) ** 2 - 1]
        most.append(max(float(band.abs().max()), 1e-9))
        bands.append(band / most[-1] * 127)
    others = torch.cat(bands, dim=1).permute(1, 2, 0) if bands else torch.zeros(0, 3, len(sh))
    ranges = {"low": low, "high": high, "most": most}
    return ranges, _bytes(first.T, np.uint8), _bytes(others, np.int8)


def _gains(moments: Sequence[Tensor]) -> Array:
    """(T, N) uint8: logarithms of the factors, 128 is 1."""
    return _bytes(torch.stack(list(moments)).clamp_min(1e-6).log2() * _GAIN + 128, np.uint8)


def _bytes(values: Tensor, kind: type[Any]) -> Array:
    """Round to whole numbers of a type, and clip to what it holds."""
    known = np.iinfo(kind)
    return values.round().clamp(known.min, known.max).contiguous().numpy().astype(kind)


def _joined(arrays: dict[str, Array]) -> tuple[bytes, dict[str, Any]]:
    """All bytes, each array from a multiple of 4 on, and where each lies."""
    data, places = bytearray(), dict[str, Any]()
    for name, values in arrays.items():
        places[name] = {"type": values.dtype.name, "from": len(data), "length": values.size}
        data += values.astype(values.dtype.newbyteorder("<")).tobytes()
        data += bytes(-len(data) % 4)
    return bytes(data), places
