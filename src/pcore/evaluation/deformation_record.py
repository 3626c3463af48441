"""How a deformed state was made: the file `STATE/deformation.json` beside its views."""

from __future__ import annotations

from typing import Literal

import torch
from pydantic import BaseModel, ConfigDict

from pcore.deform.base import Deformation
from pcore.deform.frame import axis_frame, bend_frame
from pcore.deform.simple import Bend, Stretch, Taper, Twist, uniform_scale

_ALONG_AXIS = {"TWIST": Twist, "TAPER": Taper, "STRETCH": Stretch}


class DeformationRecord(BaseModel):
    """What `STATE/deformation.json` says; formulas in Blender's Simple Deform conventions."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    type: str
    method: Literal["TWIST", "BEND", "TAPER", "STRETCH"] = "TWIST"
    axis: Literal["X", "Y", "Z"] = "Z"
    value: float = 0.0
    factor: float = 1.0
    limits: tuple[float, float] = (0.0, 1.0)
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lock: tuple[bool, bool, bool] = (False, False, False)
    driver_lo: float = 0.0
    driver_hi: float = 0.0

    def deformation(self) -> Deformation | None:
        """Return the map of space, or None when the state has no formula (an animation).

        Raises:
            InputError: the numbers make no deformation (empty extent, factor not positive).
        """
        if self.type == "scale":
            return uniform_scale(self.factor, self.origin)
        if self.type != "simple_deform":
            return None
        origin = torch.tensor(self.origin, dtype=torch.float64)
        extent = (self.driver_lo, self.driver_hi)
        axis = self.axis.lower()
        if self.method == "BEND":
            return Bend(
                rotation=bend_frame(axis),
                origin=origin,
                extent=extent,
                value=self.value,
                limits=self.limits,
            )
        index = "xyz".index(axis)
        return _ALONG_AXIS[self.method](
            rotation=axis_frame(axis),
            origin=origin,
            extent=extent,
            value=self.value,
            limits=self.limits,
            lock=(self.lock[(index + 1) % 3], self.lock[(index + 2) % 3]),
        )
