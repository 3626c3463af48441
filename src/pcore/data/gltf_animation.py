"""Clips of a glTF file: what its nodes do in time.

Khronos, "glTF 2.0 Specification", 3.11 Animations and appendix C; a posed file is the file with
other transforms of its nodes, so that `read_shape` skins and morphs it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from pcore.data.gltf import Glb, Index, Node
from pcore.data.gltf_arrays import item, read_accessor
from pcore.errors import InputError
from pcore.validation import parse

FloatArray = NDArray[np.float64]
Path = Literal["translation", "rotation", "scale", "weights"]
_KIND = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3", "weights": "SCALAR"}
_STRAIGHT = 0.9995
"""Quaternions with a larger product are so near that a straight line serves."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class _Pointer(_Part):
    pointer: str


class _PointerOf(_Part):
    pointer: _Pointer | None = Field(default=None, alias="KHR_animation_pointer")


class _Target(_Part):
    node: Index | None = None
    path: str
    extensions: _PointerOf = _PointerOf()


class _Channel(_Part):
    sampler: Index
    target: _Target


class _Sampler(_Part):
    input: Index
    output: Index
    interpolation: Literal["LINEAR", "STEP", "CUBICSPLINE"] = "LINEAR"


class _Animation(_Part):
    name: str = ""
    channels: list[_Channel]
    samplers: list[_Sampler]


class _Animations(_Part):
    animations: list[_Animation] = Field(default=[])


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """What one number of a node does.

    Attributes:
        node: which node.
        path: which of its transforms, or the weights of its morph targets.
        times: (K,) seconds, rising.
        values: (K, C), or (K, 3, C) for cubic splines: tangent in, value, tangent out.
        interpolation: between keys.
    """

    node: int
    path: Path
    times: FloatArray
    values: FloatArray
    interpolation: Literal["LINEAR", "STEP", "CUBICSPLINE"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Clip:
    """An animation.

    Attributes:
        name: its name, or `clip` and its number where it has none.
        tracks: what moves.
    """

    name: str
    tracks: tuple[Track, ...]

    @property
    def span(self) -> tuple[float, float]:
        """First and last key, seconds."""
        return (
            min(float(one.times[0]) for one in self.tracks),
            max(float(one.times[-1]) for one in self.tracks),
        )


def read_clips(glb: Glb) -> tuple[Clip, ...]:
    """Read all animations that move nodes; a name that was there before gets a number.

    Raises:
        InputError: damaged keys, or nodes that move by KHR_animation_pointer.
    """
    found = parse(_Animations, glb.data, where=glb.where, error=InputError)
    clips: list[Clip] = []
    for number, one in enumerate(found.animations):
        tracks = [
            _track(glb, channel, one.samplers)
            for channel in one.channels
            if _moves(channel.target, glb.where)
        ]
        if tracks:
            clips.append(Clip(name=_free(one.name or f"clip{number}", clips), tracks=tuple(tracks)))
    return tuple(clips)


def _moves(target: _Target, where: str) -> bool:
    """Whether a channel moves a node; others change colours of materials and the like."""
    pointer = target.extensions.pointer
    if pointer is not None and pointer.pointer.startswith("/nodes/"):
        raise InputError(
            f"{where}: {pointer.pointer} is moved by KHR_animation_pointer, which is not read: "
            "expected the standard's own channels; export it without that extension"
        )
    return target.node is not None and target.path in _KIND


def _free(name: str, clips: Sequence[Clip]) -> str:
    taken, found, number = {one.name for one in clips}, name, 1
    while found in taken:
        number += 1
        found = f"{name} {number}"
    return found


def at_time(glb: Glb, clip: Clip, time: float) -> Glb:
    """Return the file as it stands at a time of a clip; before and after it, its ends.

    Raises:
        InputError: a node that has a matrix is moved, which glTF does not allow.
    """
    nodes = list(glb.document.nodes)
    for track in clip.tracks:
        node = item(nodes, track.node, "nodes", glb.where)
        if node.matrix is not None and track.path != "weights":
            raise InputError(
                f"{glb.where}: expected a node with translation, rotation and scale where clip "
                f"{clip.name!r} moves it, got a matrix; the file is damaged"
            )
        value = [float(x) for x in value_at(track, time)]
        nodes[track.node] = node.model_copy(update={track.path: _as_field(track.path, value)})
    return replace(glb, document=glb.document.model_copy(update={"nodes": nodes}))


def _as_field(path: Path, value: list[float]) -> Any:
    return value if path == "weights" else tuple(value)


def value_at(track: Track, time: float) -> FloatArray:
    """Value (C,) of a track at a time."""
    times = track.times
    time = float(np.clip(time, times[0], times[-1]))
    after = int(np.clip(np.searchsorted(times, time, side="right"), 1, max(1, len(times) - 1)))
    before = after - 1
    if len(times) == 1 or track.interpolation == "STEP":
        key = int(np.searchsorted(times, time, side="right")) - 1
        return _middle(track)[key]
    length = times[after] - times[before]
    share = (time - times[before]) / length
    if track.interpolation == "CUBICSPLINE":
        value = _spline(track.values[before], track.values[after], share, length)
        return value / np.linalg.norm(value) if track.path == "rotation" else value
    first, last = track.values[before], track.values[after]
    if track.path == "rotation":
        return _slerp(first, last, share)
    return (1 - share) * first + share * last


def _middle(track: Track) -> FloatArray:
    return track.values[:, 1] if track.interpolation == "CUBICSPLINE" else track.values


def _spline(first: FloatArray, last: FloatArray, t: float, length: float) -> FloatArray:
    """Hermite curve from the value of one key (3, C) to that of the next."""
    return (
        (2 * t**3 - 3 * t**2 + 1) * first[1]
        + length * (t**3 - 2 * t**2 + t) * first[2]
        + (3 * t**2 - 2 * t**3) * last[1]
        + length * (t**3 - t**2) * last[0]
    )


def _slerp(first: FloatArray, last: FloatArray, share: float) -> FloatArray:
    """From one quaternion to another at an even pace, the short way round."""
    first, last = first / np.linalg.norm(first), last / np.linalg.norm(last)
    product = float(first @ last)
    if product < 0:
        last, product = -last, -product
    if product > _STRAIGHT:
        mixed = (1 - share) * first + share * last
        return mixed / np.linalg.norm(mixed)
    angle = np.arccos(product)
    return (np.sin((1 - share) * angle) * first + np.sin(share * angle) * last) / np.sin(angle)


def _track(glb: Glb, channel: _Channel, samplers: Sequence[_Sampler]) -> Track:
    sampler = item(samplers, channel.sampler, "samplers", glb.where)
    path: Path = channel.target.path  # pyright: ignore[reportAssignmentType] - checked by callers
    node = channel.target.node
    assert node is not None
    item(glb.document.nodes, node, "nodes", glb.where)
    times = read_accessor(glb, sampler.input, "SCALAR")[:, 0].astype(np.float64)
    values = read_accessor(glb, sampler.output, _KIND[path]).astype(np.float64)
    spline = sampler.interpolation == "CUBICSPLINE"
    columns = _targets(glb.document.nodes[node], glb) if path == "weights" else values.shape[1]
    shape = (len(times), 3, columns) if spline else (len(times), columns)
    if values.size != np.prod(shape):
        raise InputError(
            f"{glb.where}: expected {int(np.prod(shape))} numbers for the {path} of node {node}, "
            f"got {values.size}; the file is damaged"
        )
    if not (np.isfinite(times).all() and np.isfinite(values).all() and (np.diff(times) > 0).all()):
        raise InputError(
            f"{glb.where}: expected finite keys at rising times for the {path} of node {node}; the "
            "file is damaged: export it again"
        )
    keys = values.reshape(shape)[:, 1] if spline else values.reshape(shape)
    if path == "rotation" and not np.linalg.norm(keys, axis=-1).all():
        raise InputError(
            f"{glb.where}: expected turns as keys of node {node}, got a quaternion of zeros; the "
            "file is damaged: export it again"
        )
    return Track(
        node=node,
        path=path,
        times=times,
        values=values.reshape(shape),
        interpolation=sampler.interpolation,
    )


def _targets(node: Node, glb: Glb) -> int:
    """Morph targets of a node's mesh."""
    if node.mesh is None:
        return 0
    mesh = item(glb.document.meshes, node.mesh, "meshes", glb.where)
    return max((len(one.targets) for one in mesh.primitives), default=0)
