"""Arrays of a glTF file: accessors of any type, strided, sparse, quantised or normalised."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pcore.data.gltf import Accessor, Glb, refuse_extension
from pcore.errors import InputError

_DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_MOST = 2**28
"""Numbers of an accessor without data, which a damaged file can ask for any number of."""
_Item = TypeVar("_Item")


def item(items: Sequence[_Item], index: int, what: str, where: str) -> _Item:
    """Entry of a list of the file; InputError where a number leads to none."""
    if not 0 <= index < len(items):
        raise InputError(
            f"{where}: expected the number of one of its {len(items)} {what}, got {index}; the "
            "file is damaged"
        )
    return items[index]


def read_accessor(glb: Glb, index: int, kind: str) -> NDArray[Any]:
    """Values (count, components) of an accessor; normalised ones are float64 from -1 or 0 to 1.

    Args:
        glb: the file.
        index: which accessor.
        kind: the type that is expected, "VEC3".

    Raises:
        InputError: another type, data beyond the file's, or compressed data.
    """
    accessor = item(glb.document.accessors, index, "accessors", glb.where)
    if accessor.type != kind:
        raise InputError(
            f"{glb.where}: expected accessor {index} of the type {kind}, got {accessor.type}; the "
            "file is damaged"
        )
    size = _SIZES[kind]
    dtype = np.dtype(_DTYPES[accessor.componentType])
    if accessor.bufferView is not None:
        shape = (accessor.count, size)
        values = _view(glb, accessor.bufferView, accessor.byteOffset, dtype, shape, strided=True)
    elif accessor.sparse is not None and accessor.count * size <= _MOST:
        values = np.zeros((accessor.count, size), dtype=dtype)
    else:
        raise InputError(
            f"{glb.where}: expected accessor {index} with data, got none; export without "
            "compression"
        )
    if accessor.sparse is not None:
        values = _with_sparse(glb, accessor, values)
    return _normalised(values) if accessor.normalized else values


def read_bytes(glb: Glb, index: int) -> bytes:
    """Bytes of a buffer view, as of an image.

    Raises:
        InputError: data beyond the file's.
    """
    view = item(glb.document.bufferViews, index, "buffer views", glb.where)
    content = _buffer(glb, view.buffer)
    end = view.byteOffset + view.byteLength
    if end > len(content):
        raise InputError(
            f"{glb.where}: expected {view.byteLength:,} bytes in buffer view {index}, got fewer; "
            "the file is damaged or cut short: export or download it again"
        )
    return content[view.byteOffset : end]


def _with_sparse(glb: Glb, accessor: Accessor, values: NDArray[Any]) -> NDArray[Any]:
    sparse = accessor.sparse
    assert sparse is not None
    at, new = sparse.indices, sparse.values
    kind = np.dtype(_DTYPES[at.componentType])
    rows = _view(glb, at.bufferView, at.byteOffset, kind, (sparse.count, 1))[:, 0]
    shape = (sparse.count, values.shape[1])
    changed = _view(glb, new.bufferView, new.byteOffset, values.dtype, shape)
    if int(rows.max()) >= len(values):
        raise InputError(
            f"{glb.where}: expected sparse rows below {len(values)}, got {int(rows.max())}; the "
            "file is damaged"
        )
    mended = values.copy()
    mended[rows] = changed
    return mended


def _normalised(values: NDArray[Any]) -> NDArray[np.float64]:
    if values.dtype.kind == "f":
        return values.astype(np.float64)
    return np.maximum(values / float(np.iinfo(values.dtype).max), -1.0)


def _view(
    glb: Glb,
    index: int,
    offset: int,
    dtype: np.dtype[Any],
    shape: tuple[int, int],
    *,
    strided: bool = False,
) -> NDArray[Any]:
    """Read an array (rows, columns) from a buffer view."""
    view = item(glb.document.bufferViews, index, "buffer views", glb.where)
    for name in view.extensions:
        if "meshopt" in name:
            raise refuse_extension(name, glb.where)
    row = dtype.itemsize * shape[1]
    stride = view.byteStride if strided and view.byteStride else row
    content = _buffer(glb, view.buffer)
    start, end = view.byteOffset + offset, view.byteOffset + view.byteLength
    last = start + stride * (shape[0] - 1) + row
    if last > end or end > len(content) or stride < row:
        raise InputError(
            f"{glb.where}: expected {shape[0]} rows in buffer view {index}, got one that is too "
            "short; the file is damaged or cut short: export or download it again"
        )
    strides = (stride, dtype.itemsize)
    return np.ndarray(shape, dtype, buffer=content, offset=start, strides=strides)


def _buffer(glb: Glb, index: int) -> bytes:
    buffer = item(glb.document.buffers, index, "buffers", glb.where)
    if buffer.uri is None:
        if index > 0:
            raise InputError(
                f"{glb.where}: expected buffer {index} with data, got none; export without "
                "compression"
            )
        return glb.binary
    if not buffer.uri.startswith("data:"):
        raise InputError(
            f"{glb.where}: expected one file, got one whose numbers lie in {buffer.uri[:60]!r}: "
            "export glTF Binary (.glb) with its data included"
        )
    try:
        return base64.b64decode(buffer.uri.partition(",")[2], validate=True)
    except (binascii.Error, ValueError):
        raise InputError(f"{glb.where}: expected data in base64, got a damaged buffer") from None
