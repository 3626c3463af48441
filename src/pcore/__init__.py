"""P-CORE: edit captured objects as neural points that stay hole-free when they are deformed.

The names below are the ones most programs need; everything else is imported from its module. They
are loaded on first use, so that `import pcore` does not wait for torch.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pcore.data.load import load_scene
    from pcore.data.scene import Scene
    from pcore.deform.base import Deformation
    from pcore.editing.script import load_edit
    from pcore.editing.session import EditSession
    from pcore.errors import PcoreError
    from pcore.files.model_file import load_model
    from pcore.geometry.camera import Camera
    from pcore.geometry.point_cloud import PointCloud
    from pcore.geometry.rays import RayBundle
    from pcore.model.papr import Papr, Rendering
    from pcore.render.picture import render
    from pcore.training.finetune import finetune
    from pcore.training.presets import finetune_preset, preset
    from pcore.training.pretrain import pretrain

    __version__: str

__all__ = [
    "Camera",
    "Deformation",
    "EditSession",
    "Papr",
    "PcoreError",
    "PointCloud",
    "RayBundle",
    "Rendering",
    "Scene",
    "__version__",
    "finetune",
    "finetune_preset",
    "load_edit",
    "load_model",
    "load_scene",
    "preset",
    "pretrain",
    "render",
]

_HOMES = {
    "Camera": "pcore.geometry.camera",
    "Deformation": "pcore.deform.base",
    "EditSession": "pcore.editing.session",
    "Papr": "pcore.model.papr",
    "PcoreError": "pcore.errors",
    "PointCloud": "pcore.geometry.point_cloud",
    "RayBundle": "pcore.geometry.rays",
    "Rendering": "pcore.model.papr",
    "Scene": "pcore.data.scene",
    "finetune": "pcore.training.finetune",
    "finetune_preset": "pcore.training.presets",
    "load_edit": "pcore.editing.script",
    "load_model": "pcore.files.model_file",
    "load_scene": "pcore.data.load",
    "preset": "pcore.training.presets",
    "pretrain": "pcore.training.pretrain",
    "render": "pcore.render.picture",
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
