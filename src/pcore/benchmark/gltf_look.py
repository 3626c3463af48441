"""The paint of a glTF file: base colours, textures, vertex colours, normals; metal and gloss not.

Khronos, "glTF 2.0 Specification", 3.9 Materials; extensions KHR_texture_transform and
KHR_materials_pbrSpecularGlossiness.
"""

from __future__ import annotations

import base64
import binascii
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict

from pcore.benchmark.look import FloatArray, Look, Material, Texture, smooth_patches
from pcore.benchmark.texture_pixels import texture_pixels
from pcore.data.gltf import Glb, Index, Number, Primitive
from pcore.data.gltf_arrays import item, read_accessor, read_bytes
from pcore.data.gltf_mesh import primitive_faces, shown_primitives
from pcore.errors import InputError
from pcore.validation import parse

_WRAP = {33071: "clamp", 33648: "mirror", 10497: "repeat"}
_BLEND_CUTOFF = 0.5
"""Surfaces that are to be blended are cut out at this alpha."""
_MOST_SETS = 2
"""Of texture coordinates, as in glTF."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class _Moved(_Part):
    offset: tuple[Number, Number] = (0.0, 0.0)
    scale: tuple[Number, Number] = (1.0, 1.0)
    rotation: Number = 0.0
    texCoord: Index | None = None  # noqa: N815


class _InfoExtensions(_Part):
    KHR_texture_transform: _Moved = _Moved()


class _TextureInfo(_Part):
    index: Index
    texCoord: Index = 0  # noqa: N815
    extensions: _InfoExtensions = _InfoExtensions()


class _Pbr(_Part):
    baseColorFactor: tuple[Number, Number, Number, Number] = (1.0, 1.0, 1.0, 1.0)  # noqa: N815
    baseColorTexture: _TextureInfo | None = None  # noqa: N815


class _SpecularGlossiness(_Part):
    diffuseFactor: tuple[Number, Number, Number, Number] = (1.0, 1.0, 1.0, 1.0)  # noqa: N815
    diffuseTexture: _TextureInfo | None = None  # noqa: N815


class _MaterialExtensions(_Part):
    KHR_materials_pbrSpecularGlossiness: _SpecularGlossiness | None = None


class _Material(_Part):
    pbrMetallicRoughness: _Pbr = _Pbr()  # noqa: N815
    extensions: _MaterialExtensions = _MaterialExtensions()
    alphaMode: Literal["OPAQUE", "MASK", "BLEND"] = "OPAQUE"  # noqa: N815
    alphaCutoff: Number = 0.5  # noqa: N815
    emissiveFactor: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)  # noqa: N815


class _Webp(_Part):
    source: Index


class _TextureExtensions(_Part):
    model_config = ConfigDict(extra="allow")

    EXT_texture_webp: _Webp | None = None


class _Texture(_Part):
    sampler: Index | None = None
    source: Index | None = None
    extensions: _TextureExtensions = _TextureExtensions()


class _Sampler(_Part):
    wrapS: int = 10497  # noqa: N815
    wrapT: int = 10497  # noqa: N815


class _Image(_Part):
    uri: str | None = None
    bufferView: Index | None = None  # noqa: N815


class _Paint(_Part):
    materials: list[_Material] = []
    textures: list[_Texture] = []
    samplers: list[_Sampler] = []
    images: list[_Image] = []


def read_look(glb: Glb, places: FloatArray) -> Look:
    """Read what is painted on the shape that `read_shape` reads, part by part in its order.

    Args:
        glb: the file.
        places: (V, 3) the vertices of the shape.

    Raises:
        InputError: damaged, or a texture in a format that is not read; the message names it.
    """
    paint = parse(_Paint, glb.data, where=glb.where, error=InputError)
    materials = [_material(glb, paint, one) for one in paint.materials]
    parts = [_part(glb, primitive, len(materials)) for _, _, primitive in shown_primitives(glb)]
    if not parts:
        raise InputError(f"{glb.where}: expected a mesh with triangles, got none")
    # Where some parts have no colours of their own, white changes nothing.
    return Look(
        materials=(*materials, Material()),
        material_of_face=np.concatenate([one["material"] for one in parts]),
        uv=tuple(np.concatenate([one["uv"][k] for one in parts]) for k in range(_MOST_SETS)),
        colors=np.concatenate([one["colors"] for one in parts]),
        smooth=smooth_patches(places, np.concatenate([one["normals"] for one in parts])),
    )


def _part(glb: Glb, primitive: Primitive, default: int) -> dict[str, Any]:
    attributes = primitive.attributes
    count = item(glb.document.accessors, attributes["POSITION"], "accessors", glb.where).count
    faces = primitive_faces(glb, primitive, count)
    material = default if primitive.material is None else primitive.material
    if not 0 <= material <= default:
        raise InputError(
            f"{glb.where}: expected the number of one of its {default} materials, got {material}"
        )
    return {
        "material": np.full(len(faces), material),
        "uv": [_uv(glb, attributes.get(f"TEXCOORD_{k}"), count) for k in range(_MOST_SETS)],
        "colors": _colors(glb, attributes.get("COLOR_0"), count),
        "normals": _rows(glb, attributes["NORMAL"], count)
        if "NORMAL" in attributes
        else np.zeros((count, 3)),
    }


def _rows(glb: Glb, index: int, count: int, kind: str = "VEC3") -> FloatArray:
    values = read_accessor(glb, index, kind).astype(np.float64)
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(
            f"{glb.where}: expected {count} finite rows in accessor {index}, got {len(values)} or "
            "NaN; the file is damaged"
        )
    return values


def _uv(glb: Glb, index: int | None, count: int) -> FloatArray:
    return np.zeros((count, 2)) if index is None else _rows(glb, index, count, "VEC2")


def _colors(glb: Glb, index: int | None, count: int) -> FloatArray:
    """Linear RGBA (count, 4); white where a part has no colours."""
    if index is None:
        return np.ones((count, 4))
    kind = item(glb.document.accessors, index, "accessors", glb.where).type
    values = _rows(glb, index, count, kind if kind in ("VEC3", "VEC4") else "VEC4")
    return values if kind == "VEC4" else np.column_stack([values, np.ones(count)])


def _material(glb: Glb, paint: _Paint, material: _Material) -> Material:
    pbr = material.pbrMetallicRoughness
    cutoffs = {"OPAQUE": 0.0, "MASK": material.alphaCutoff, "BLEND": _BLEND_CUTOFF}
    color, info = pbr.baseColorFactor, pbr.baseColorTexture
    # Converters of older files give this in the place of base colours, or beside paler ones.
    other = material.extensions.KHR_materials_pbrSpecularGlossiness
    if other is not None:
        color, info = other.diffuseFactor, other.diffuseTexture
    return Material(
        color=color,
        texture=None if info is None else _texture(glb, paint, info),
        cutoff=cutoffs[material.alphaMode],
        emits=any(material.emissiveFactor),
    )


def _texture(glb: Glb, paint: _Paint, info: _TextureInfo) -> Texture:
    texture = item(paint.textures, info.index, "textures", glb.where)
    sampler = _Sampler()
    if texture.sampler is not None:
        sampler = item(paint.samplers, texture.sampler, "samplers", glb.where)
    source = texture.source
    if source is None:
        webp = texture.extensions.EXT_texture_webp
        if webp is None:
            names = ", ".join(texture.extensions.model_extra or {}) or "nothing"
            raise InputError(
                f"{glb.where}: expected a texture in PNG, JPEG or WebP, got {names}; export with "
                "plain images"
            )
        source = webp.source
    moved = info.extensions.KHR_texture_transform
    uv_set = info.texCoord if moved.texCoord is None else moved.texCoord
    if uv_set >= _MOST_SETS:
        raise InputError(
            f"{glb.where}: expected textures that use TEXCOORD_0 or 1, got TEXCOORD_{uv_set}"
        )
    return Texture(
        pixels=texture_pixels(
            _content(glb, item(paint.images, source, "images", glb.where)), glb.where
        ),
        wrap=(_WRAP.get(sampler.wrapS, "repeat"), _WRAP.get(sampler.wrapT, "repeat")),
        uv_set=uv_set,
        offset=moved.offset,
        scale=moved.scale,
        rotation=moved.rotation,
    )


def _content(glb: Glb, image: _Image) -> bytes:
    if image.bufferView is not None:
        return read_bytes(glb, image.bufferView)
    uri = image.uri or ""
    if not uri.startswith("data:"):
        raise InputError(
            f"{glb.where}: expected textures inside the file, got {uri[:60]!r}: export glTF Binary "
            "(.glb) with its images included"
        )
    try:
        return base64.b64decode(uri.partition(",")[2], validate=True)
    except (binascii.Error, ValueError):
        raise InputError(f"{glb.where}: expected a texture in base64, got a damaged one") from None
