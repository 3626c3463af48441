"""The deformed states of the embedded sample: the maps and how their files describe them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from pcore.deform.base import Deformation
from pcore.deform.frame import axis_frame, bend_frame
from pcore.deform.simple import Bend, Stretch, Twist, uniform_scale

Array = NDArray[Any]
Axis = Literal["x", "y", "z"]

ANGLE_X = 0.6911112070083618  # horizontal field of view of NeRF-Synthetic in radians


@dataclass(frozen=True, kw_only=True)
class DeformedState:
    """A deformed state of the sample.

    Attributes:
        deformation: the true map from canonical to deformed points.
        angle_x: horizontal field of view in radians that the deformed object fits in.
        description: content of `deformation.json`.
    """

    deformation: Deformation
    angle_x: float
    description: dict[str, Any]


def deformed_states(
    vertices: Array, *, axis: Literal["x", "z"] = "x", bend_axis: Axis | None = None
) -> dict[str, DeformedState]:
    """States by name.

    Args:
        vertices: (V, 3), whose extents are those of the maps.
        axis: along which the object is twisted, bent and stretched.
        bend_axis: about which it is bent; None: the one whose bend runs along `axis`, z or y.
    """
    angle, factor, scale = math.pi / 3, 0.6, 2.0
    origin, extent = torch.zeros(3, dtype=torch.float64), _extent(vertices, axis)
    # In Blender a bend about z is driven by x, and one about x or y by z.
    about: Axis = bend_axis or ("z" if axis == "x" else "y")
    driver: Literal["x", "z"] = "x" if about == "z" else "z"
    bent = _extent(vertices, driver)
    along, around, big = axis_frame(axis), bend_frame(about), axis.upper()
    wide = 2.0 * math.atan(scale * math.tan(0.5 * ANGLE_X))
    return {
        "twist60": DeformedState(
            deformation=Twist(rotation=along, origin=origin, extent=extent, value=angle),
            angle_x=ANGLE_X,
            description=_simple_deform("twist60", ("TWIST", big), angle, extent, big),
        ),
        "bend60": DeformedState(
            deformation=Bend(rotation=around, origin=origin, extent=bent, value=angle),
            angle_x=ANGLE_X,
            description=_simple_deform(
                "bend60", ("BEND", about.upper()), angle, bent, driver.upper()
            ),
        ),
        "stretch": DeformedState(
            deformation=Stretch(rotation=along, origin=origin, extent=extent, value=factor),
            angle_x=ANGLE_X,
            description=_simple_deform("stretch", ("STRETCH", big), factor, extent, big),
        ),
        "scale2x": DeformedState(
            deformation=uniform_scale(scale),
            angle_x=wide,
            description={
                "name": "scale2x",
                "type": "scale",
                "camera_angle_x": wide,
                "factor": scale,
                "origin": [0.0, 0.0, 0.0],
                "note": "camera poses as canonical, wider field of view so that the object fits",
            },
        ),
    }


def _extent(vertices: Array, axis: Axis) -> tuple[float, float]:
    values = vertices[:, "xyz".index(axis)]
    return float(values.min()), float(values.max())


def _simple_deform(
    name: str,
    method_axis: tuple[str, str],
    value: float,
    extent: tuple[float, float],
    driver: str,
) -> dict[str, Any]:
    """Describe a Simple Deform about the origin that is driven by an axis over `extent`."""
    method, axis = method_axis
    return {
        "name": name,
        "type": "simple_deform",
        "camera_angle_x": ANGLE_X,
        "method": method,
        "axis": axis,
        "value": value,
        "value_is": "factor" if method == "STRETCH" else "angle_rad",
        "limits": [0.0, 1.0],
        "origin": [0.0, 0.0, 0.0],
        "lock": [0, 0, 0],
        "driver_axis": driver,
        "driver_lo": extent[0],
        "driver_hi": extent[1],
        "k_per_unit": value / (extent[1] - extent[0]),
    }


def describe_state(state: DeformedState, before: Array, after: Array) -> dict[str, Any]:
    """Content of `deformation.json` with statistics of the vertices (V, 3) before and after."""
    displacement = np.linalg.norm(after - before, axis=1)
    return {
        **state.description,
        "vertex_displacement_mean": float(displacement.mean()),
        "vertex_displacement_max": float(displacement.max()),
        "bbox_min": after.min(axis=0).tolist(),
        "bbox_max": after.max(axis=0).tolist(),
    }
