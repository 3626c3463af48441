"""The structure of a glTF file (.glb or .gltf), version 2, as far as shapes need it.

Khronos, "glTF 2.0 Specification". What the file asks for and is not read here is an error that
names it: nothing falls back to a shape that the file does not have.
"""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import unquote

from pydantic import BaseModel, ConfigDict, Field

from pcore.data.file_kinds import kind_of
from pcore.errors import InputError
from pcore.validation import parse

Index = Annotated[int, Field(ge=0)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Extensions = dict[str, Any]

_HARMLESS = (
    *("KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_", "KHR_xmp"),
    *("KHR_mesh_quantization", "KHR_animation_pointer", "KHR_node_visibility"),
)
"""How names of extensions begin that leave shapes as they are, or that are read."""
_JSON, _BIN = 0x4E4F534A, 0x004E4942


class _Part(BaseModel):
    """Keys that are not listed are of no concern: materials, cameras, names."""

    model_config = ConfigDict(extra="ignore", frozen=True, strict=False)


class Buffer(_Part):
    """Bytes."""

    byteLength: Index  # noqa: N815 - these are the keys of the format
    uri: str | None = None


class BufferView(_Part):
    """A stretch of a buffer."""

    buffer: Index
    byteLength: Index  # noqa: N815
    byteOffset: Index = 0  # noqa: N815
    byteStride: Index | None = None  # noqa: N815
    extensions: Extensions = {}


class SparseValues(_Part):
    """What a sparse accessor puts into the rows that it changes."""

    bufferView: Index  # noqa: N815
    byteOffset: Index = 0  # noqa: N815


class SparseIndices(SparseValues):
    """Which rows those are."""

    componentType: Literal[5121, 5123, 5125]  # noqa: N815


class Sparse(_Part):
    """Rows of an accessor that differ from its buffer view, or from 0."""

    count: Annotated[int, Field(ge=1)]
    indices: SparseIndices
    values: SparseValues


class Accessor(_Part):
    """An array of vectors."""

    count: Annotated[int, Field(ge=1)]
    componentType: Literal[5120, 5121, 5122, 5123, 5125, 5126]  # noqa: N815
    type: Literal["SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"]
    bufferView: Index | None = None  # noqa: N815
    byteOffset: Index = 0  # noqa: N815
    normalized: bool = False
    sparse: Sparse | None = None


class Primitive(_Part):
    """Triangles (mode 4, 5 or 6), lines or points of one material."""

    attributes: dict[str, Index]
    indices: Index | None = None
    mode: int = 4
    material: int | None = None
    targets: list[dict[str, Index]] = []
    extensions: Extensions = {}


class Mesh(_Part):
    """Primitives that are moved and shaped together."""

    primitives: list[Primitive]
    weights: list[Number] = []


class Node(_Part):
    """A place in the tree, with what lies there."""

    mesh: Index | None = None
    skin: Index | None = None
    children: list[Index] = []
    matrix: Annotated[list[Number], Field(min_length=16, max_length=16)] | None = None
    translation: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    rotation: tuple[Number, Number, Number, Number] = (0.0, 0.0, 0.0, 1.0)
    scale: tuple[Number, Number, Number] = (1.0, 1.0, 1.0)
    weights: list[Number] | None = None
    extensions: Extensions = {}


class Skin(_Part):
    """Nodes that carry vertices, and where they are at rest."""

    joints: Annotated[list[Index], Field(min_length=1)]
    inverseBindMatrices: Index | None = None  # noqa: N815


class Scene(_Part):
    """Roots of what is shown."""

    nodes: list[Index] = []


class Asset(_Part):
    """Which format it is."""

    version: str


class Document(_Part):
    """The JSON of a file."""

    asset: Asset
    extensionsRequired: list[str] = []  # noqa: N815
    scene: Index | None = None
    scenes: list[Scene] = []
    nodes: list[Node] = []
    meshes: list[Mesh] = []
    skins: list[Skin] = []
    accessors: list[Accessor] = []
    bufferViews: list[BufferView] = []  # noqa: N815
    buffers: list[Buffer] = []


@dataclass(frozen=True, kw_only=True)
class Glb:
    """A glTF file.

    Attributes:
        document: its JSON, as far as shapes need it.
        data: its JSON as it is.
        binary: its binary chunk or first buffer, empty where it has none.
        where: its name, for messages.
    """

    document: Document
    data: dict[str, Any]
    binary: bytes
    where: str


def read_glb(content: bytes, where: str) -> Glb:
    """Take a .glb apart and check what it asks for.

    Raises:
        InputError: another format or version, damaged, or in need of an extension that is not read.
    """
    if content[:4] != b"glTF":
        known = kind_of(content) or "a file that does not begin with 'glTF'"
        hint = "; export glTF Binary (.glb), which is one file" if known == "JSON text" else ""
        raise InputError(f"{where}: expected a mesh in binary glTF, got {known}{hint}")
    if content[4:8] != (2).to_bytes(4, "little"):
        version = int.from_bytes(content[4:8], "little")
        raise InputError(f"{where}: expected glTF of version 2, got version {version}")
    chunks = _chunks(content, where)
    if _JSON not in chunks:
        raise _damaged(where, "it has no JSON chunk")
    return _checked(_tree(chunks[_JSON], where), chunks.get(_BIN, b""), where)


def read_gltf(content: bytes, where: str, folder: Path) -> Glb:
    """Take a .gltf together with the files that lie beside it, and check what it asks for.

    Args:
        content: its JSON.
        where: its name, for messages.
        folder: that its files are in.

    Raises:
        InputError: as `read_glb`, or a file that is missing or lies outside the folder.
    """
    data = _tree(content, where)
    binary = b""
    for kind in ("buffers", "images"):
        entries = data.get(kind, []) if isinstance(data, dict) else []
        for number, entry in enumerate(entries if isinstance(entries, list) else []):
            uri = entry.get("uri") if isinstance(entry, dict) else None
            if not isinstance(uri, str) or uri.startswith("data:"):
                continue
            found = _beside(uri, where, folder)
            if kind == "buffers" and number == 0:
                binary = found
                del entry["uri"]
            else:
                entry["uri"] = "data:;base64," + base64.b64encode(found).decode("ascii")
    return _checked(data, binary, where)


def _beside(uri: str, where: str, folder: Path) -> bytes:
    path = (folder / unquote(uri)).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise InputError(
            f"{where}: expected files beside it, got {uri[:60]!r} outside its folder; put them "
            "together"
        )
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(
            f"{where}: expected the file {uri[:60]!r} beside it, got: {error.strerror}; bring it "
            "along, or export glTF Binary (.glb), which is one file"
        ) from None


def _tree(text: bytes, where: str) -> Any:
    try:
        return json.loads(text.decode("utf-8-sig").rstrip("\0"))
    except (ValueError, RecursionError):
        raise _damaged(where, "its JSON does not parse") from None


def _checked(data: Any, binary: bytes, where: str) -> Glb:
    document = parse(Document, data, where=where, error=InputError)
    if not document.asset.version.startswith("2."):
        raise InputError(
            f"{where}: expected glTF of version 2, got version {document.asset.version!r}"
        )
    for name in document.extensionsRequired:
        # Compressions may be required and yet not be used by what is read here.
        if not (name.startswith(_HARMLESS) or "draco" in name or "meshopt" in name):
            raise refuse_extension(name, where)
    return Glb(document=document, data=data, binary=binary, where=where)


def refuse_extension(name: str, where: str) -> InputError:
    """Build the error about an extension that is not read, with the remedy."""
    if "draco" in name:
        return InputError(
            f"{where}: compressed with Draco, which is not read: export without compression"
        )
    if "meshopt" in name:
        return InputError(
            f"{where}: compressed with meshopt ({name}), which is not read: export without "
            "compression (gltfpack: without -c)"
        )
    return InputError(
        f"{where}: expected a plain mesh, got one with the glTF extension {name}, which is not "
        "read: export without it"
    )


def _chunks(content: bytes, where: str) -> dict[int, bytes]:
    """First chunk of each kind."""
    length = int.from_bytes(content[8:12], "little")
    if length > len(content):
        raise _damaged(where, f"{len(content):,} of {length:,} bytes are there")
    found: dict[int, bytes] = {}
    place = 12
    while place + 8 <= length:
        size = int.from_bytes(content[place : place + 4], "little")
        kind = int.from_bytes(content[place + 4 : place + 8], "little")
        if place + 8 + size > length:
            raise _damaged(where, "a chunk goes on behind its end")
        found.setdefault(kind, content[place + 8 : place + 8 + size])
        place += 8 + size
    return found


def _damaged(where: str, why: str) -> InputError:
    return InputError(
        f"{where}: expected a mesh in binary glTF, got a file that is damaged ({why}): export or "
        "download it again"
    )
