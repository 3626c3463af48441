"""The keys about a lens in transforms files, and which lenses are refused.

The keys are those of the tools that write such files beside Blender (instant-ngp, nerfstudio).
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from pcore.errors import SceneError

_DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
# Models of COLMAP and nerfstudio that are pinholes when their distortion is zero.
_PINHOLES = frozenset(
    ["PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "OPENCV", "FULL_OPENCV", "RADIAL", "SIMPLE_RADIAL"]
)


def _no_flag(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("expected a number")
    return value


# RealityCapture's numbers arrive as text ("k1": "0.0"), so text that is a number is one.
Number = Annotated[float, BeforeValidator(_no_flag)]
Pixels = Annotated[int, Field(ge=1), BeforeValidator(_no_flag)]


class LensEntry(BaseModel):
    """The keys about the lens and the image, which stand at the top of the file or in a frame."""

    model_config = ConfigDict(extra="ignore")
    w: Pixels | None = None
    h: Pixels | None = None
    camera_angle_x: Number | None = None
    camera_angle_y: Number | None = None
    x_fov: Number | None = None
    y_fov: Number | None = None
    fl_x: Number | None = None
    fl_y: Number | None = None
    cx: Number | None = None
    cy: Number | None = None
    k1: Number | None = None
    k2: Number | None = None
    k3: Number | None = None
    k4: Number | None = None
    p1: Number | None = None
    p2: Number | None = None
    is_fisheye: bool | None = None
    camera_model: str | None = None
    mask_path: str | None = None


def check_pinhole(entry: LensEntry, where: str) -> None:
    """Refuse other projections, and lenses that bend straight lines: there is one ray per pixel.

    Raises:
        SceneError: names the key and its value.
    """
    bad = [f"{name} = {value:g}" for name, value in bend_of(entry).items()]
    _refuse(entry, where, bad)


def check_projection(entry: LensEntry, where: str) -> None:
    """Refuse what no straightening of the image makes a pinhole's; k1 to k3, p1, p2 are fine.

    Raises:
        SceneError: names the key and its value.
    """
    bad = [f"{name} = {value:g}" for name, value in bend_of(entry).items() if name == "k4"]
    _refuse(entry, where, bad)


def bend_of(*entries: LensEntry) -> dict[str, float]:
    """Coefficients of distortion that are not zero; later entries go before earlier ones."""
    found: dict[str, float] = {}
    for entry in entries:
        said = {name: getattr(entry, name) for name in _DISTORTION}
        found.update({name: value for name, value in said.items() if value is not None})
    return {name: value for name, value in found.items() if value}


def _refuse(entry: LensEntry, where: str, bad: list[str]) -> None:
    model = (entry.camera_model or "PINHOLE").strip().upper()
    if entry.is_fisheye:
        bad.append("a fisheye lens (is_fisheye)")
    if "FISHEYE" in model:
        bad.append(f"a fisheye lens (camera_model {entry.camera_model})")
    if bad:
        raise SceneError(
            f"{where}: expected images of a pinhole camera, got {', '.join(bad)}; undistort the "
            "images (COLMAP: image_undistorter) and write the intrinsics of the new ones, with "
            f"{', '.join(_DISTORTION)} zero or absent"
        )
    if model not in _PINHOLES:
        raise SceneError(
            f"{where}: expected images of a pinhole camera, got camera_model {entry.camera_model}; "
            "convert them to perspective images (nerfstudio's ns-process-data does so for "
            f"panoramas); read are {', '.join(sorted(_PINHOLES))}"
        )
