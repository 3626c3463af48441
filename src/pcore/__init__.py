"""P-CORE: edit captured objects as neural points that stay hole-free when they are deformed.

The names below are the ones most programs need; everything else is imported from its module. They
are loaded on first use, so that `import pcore` does not wait for torch.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pcore.asset.asset import Asset
    from pcore.asset.content import MovedPoints
    from pcore.asset.importing import import_papr
    from pcore.asset.lighting import estimate_light
    from pcore.asset.posed_asset import Posed
    from pcore.asset.saving import asset_of, load
    from pcore.asset.training import finetune, train
    from pcore.capture.load import load_cameras, load_scene
    from pcore.data.scene import Scene
    from pcore.deform.base import Deformation
    from pcore.editing.animation import load_animation
    from pcore.editing.diagnosis import diagnose
    from pcore.editing.script import EditScript, load_edit, parse_edit
    from pcore.editing.session import EditSession
    from pcore.errors import PcoreError
    from pcore.geometry.camera import Camera
    from pcore.geometry.orbit import orbit_around
    from pcore.geometry.point_cloud import PointCloud
    from pcore.geometry.rays import RayBundle
    from pcore.model.papr import Papr
    from pcore.render.image import Image
    from pcore.training.config import FinetuneConfig, PretrainConfig
    from pcore.training.in_folder import RunOptions
    from pcore.training.presets import finetune_preset, preset
    from pcore.training.pretrain import pretrain

    __version__: str

__all__ = [
    "Asset",
    "Camera",
    "Deformation",
    "EditScript",
    "EditSession",
    "FinetuneConfig",
    "Image",
    "MovedPoints",
    "Papr",
    "PcoreError",
    "PointCloud",
    "Posed",
    "PretrainConfig",
    "RayBundle",
    "RunOptions",
    "Scene",
    "__version__",
    "asset_of",
    "diagnose",
    "estimate_light",
    "finetune",
    "finetune_preset",
    "import_papr",
    "load",
    "load_animation",
    "load_cameras",
    "load_edit",
    "load_scene",
    "orbit_around",
    "parse_edit",
    "preset",
    "pretrain",
    "train",
]

_HOMES = {
    "Asset": "pcore.asset.asset",
    "Camera": "pcore.geometry.camera",
    "Deformation": "pcore.deform.base",
    "EditScript": "pcore.editing.script",
    "EditSession": "pcore.editing.session",
    "FinetuneConfig": "pcore.training.config",
    "Image": "pcore.render.image",
    "MovedPoints": "pcore.asset.content",
    "Papr": "pcore.model.papr",
    "PcoreError": "pcore.errors",
    "PointCloud": "pcore.geometry.point_cloud",
    "Posed": "pcore.asset.posed_asset",
    "PretrainConfig": "pcore.training.config",
    "RayBundle": "pcore.geometry.rays",
    "RunOptions": "pcore.training.in_folder",
    "Scene": "pcore.data.scene",
    "asset_of": "pcore.asset.saving",
    "diagnose": "pcore.editing.diagnosis",
    "estimate_light": "pcore.asset.lighting",
    "finetune": "pcore.asset.training",
    "finetune_preset": "pcore.training.presets",
    "import_papr": "pcore.asset.importing",
    "load": "pcore.asset.saving",
    "load_animation": "pcore.editing.animation",
    "load_cameras": "pcore.capture.load",
    "load_edit": "pcore.editing.script",
    "load_scene": "pcore.capture.load",
    "orbit_around": "pcore.geometry.orbit",
    "parse_edit": "pcore.editing.script",
    "preset": "pcore.training.presets",
    "pretrain": "pcore.training.pretrain",
    "train": "pcore.asset.training",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        value: Any = _version()
    elif name in _HOMES:
        value = getattr(import_module(_HOMES[name]), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _version() -> str:
    try:
        return version("pcore-edit")
    except PackageNotFoundError:
        return "unknown"
