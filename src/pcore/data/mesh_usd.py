"""Meshes with colours as USD, moving ones with samples over time."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from pcore.data.pictures import linear_colors
from pcore.geometry.surface_mesh import SurfaceMesh
from pcore.packages import package


def require_usd() -> None:
    """Check that the package of USD is there.

    Raises:
        DependencyError: it is not installed; call this before long work whose end is such a file.
    """
    instead = "or write .glb instead"
    package("pxr", extra="mesh", need="writing USD needs", named="usd-core", instead=instead)


def write_usd(
    path: Path,
    mesh: SurfaceMesh,
    frames: Sequence[Tensor] = (),
    fps: float = 30.0,
    *,
    texture: str | None = None,
) -> None:
    """Write a mesh as one prim, z up; USD has no unit of ours, so that one metre is one unit.

    Args:
        path: .usda (text), .usdc or .usd (binary).
        mesh: at rest.
        frames: (V, 3) of its vertices over time.
        fps: frames per second, which are its time codes.
        texture: name of the file of the mesh's texture, beside the file.

    Raises:
        DependencyError: the package usd-core is missing.
    """
    require_usd()
    Usd, UsdGeom, Vt = map(_pxr, ("Usd", "UsdGeom", "Vt"))  # noqa: N806

    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, "/object")
    stage.SetDefaultPrim(root.GetPrim())
    shape = UsdGeom.Mesh.Define(stage, "/object/surface")
    shape.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    corners = np.full(len(mesh.faces), 3, dtype=np.int32)
    shape.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(corners))
    corners = mesh.faces.numpy().reshape(-1).astype(np.int32)
    shape.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(corners))
    places, normals = shape.CreatePointsAttr(), shape.CreateNormalsAttr()
    shape.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    for number, vertices in enumerate(frames or (mesh.vertices,)):
        when = Usd.TimeCode(number) if frames else Usd.TimeCode.Default()
        posed = mesh.moved(vertices)
        places.Set(_vectors(posed.vertices), when)
        normals.Set(_vectors(posed.normals), when)
        extent = np.stack([posed.vertices.numpy().min(axis=0), posed.vertices.numpy().max(axis=0)])
        shape.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(extent.astype(np.float32)), when)
    if frames:
        stage.SetTimeCodesPerSecond(fps)
        stage.SetFramesPerSecond(fps)
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(len(frames) - 1)
    colors = shape.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
    colors.Set(_vectors(linear_colors(mesh.colors)))
    if texture is not None and mesh.texture is not None:
        _add_material(stage, shape, mesh.texture.coordinates, texture)
    stage.GetRootLayer().Save()


def _add_material(stage: Any, shape: Any, coordinates: Tensor, texture: str) -> None:
    """Bind a preview surface that shows a picture as light of its own."""
    UsdGeom, UsdShade, Vt = map(_pxr, ("UsdGeom", "UsdShade", "Vt"))  # noqa: N806

    kind = _pxr("Sdf").ValueTypeNames
    uv = UsdGeom.PrimvarsAPI(shape).CreatePrimvar("st", kind.TexCoord2fArray, UsdGeom.Tokens.vertex)
    uv.Set(Vt.Vec2fArray.FromNumpy(coordinates.numpy().astype(np.float32)))
    material = UsdShade.Material.Define(stage, "/object/material")
    reader = UsdShade.Shader.Define(stage, "/object/material/coordinates")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", kind.String).Set("st")
    picture = UsdShade.Shader.Define(stage, "/object/material/picture")
    picture.CreateIdAttr("UsdUVTexture")
    picture.CreateInput("file", kind.Asset).Set(f"./{texture}")
    picture.CreateInput("sourceColorSpace", kind.Token).Set("sRGB")
    picture.CreateInput("st", kind.Float2).ConnectToSource(
        reader.CreateOutput("result", kind.Float2)
    )
    surface = UsdShade.Shader.Define(stage, "/object/material/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    rgb = picture.CreateOutput("rgb", kind.Float3)
    surface.CreateInput("diffuseColor", kind.Color3f).ConnectToSource(rgb)
    surface.CreateInput("roughness", kind.Float).Set(1.0)
    output = surface.CreateOutput("surface", kind.Token)
    material.CreateSurfaceOutput().ConnectToSource(output)
    UsdShade.MaterialBindingAPI.Apply(shape.GetPrim()).Bind(material)


def _vectors(values: Tensor) -> Any:
    return _pxr("Vt").Vec3fArray.FromNumpy(np.ascontiguousarray(values.numpy().astype(np.float32)))


def _pxr(name: str) -> Any:
    """A module of the package, which is bound code that type checkers cannot read."""
    return import_module(f"pxr.{name}")
