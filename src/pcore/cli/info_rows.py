"""What `pcore info` says of a scene or capture: what was read, what was not, and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from pcore.capture.layouts import PHOTOS, VIDEO, layouts_of
from pcore.capture.load import load_scene
from pcore.data.scene import Scene, View
from pcore.files.manifest import MANIFEST_FILE
from pcore.geometry.object_region import coordinates


def is_scene(path: Path) -> bool:
    """Whether something lies there that `load_scene` has a reader for, and no run."""
    if not path.is_dir() or (path / MANIFEST_FILE).is_file():
        return False
    return bool(layouts_of(path)) or (path / "start" / "transforms_train.json").is_file()


def scene_rows(path: Path) -> list[tuple[str, str]]:
    """Name and value of all there is to say about a scene."""
    unposed = [one for one in layouts_of(path) if one.name in (PHOTOS, VIDEO)]
    if unposed:
        return [
            ("scene", str(path)),
            ("layout", f"{unposed[0].name}, without poses"),
            ("poses", "found by COLMAP when it is trained (extra `colmap`)"),
        ]
    scene = load_scene(path)
    views = [view for split in scene.views.values() for view in split]
    rows = [
        ("scene", str(path)),
        ("layout", scene.layout),
        ("views", ", ".join(f"{len(found)} {name}" for name, found in scene.views.items())),
        ("sizes", _counted(f"{v.camera.width} x {v.camera.height}" for v in views)),
        ("lenses", _lenses(views)),
        ("masks", _counted(map(_mask, views))),
        ("sparse points", _points(scene)),
        ("region", _region(scene)),
        ("states", ", ".join(scene.states) or "none"),
        ("not used", f"{len(scene.skipped)} photos"),
    ]
    rows += [(f"not used: {one.name}", one.reason) for one in scene.skipped]
    return rows + [("note", note) for note in scene.notes]


def _counted(values: Iterable[str]) -> str:
    counts = Counter(values)
    if len(counts) == 1:
        return next(iter(counts))
    return ", ".join(f"{value} ({count} views)" for value, count in counts.most_common(8))


def _mask(view: View) -> str:
    alpha = "alpha channel" if view.image.header.has_alpha else "none"
    return "mask file" if view.image.mask else alpha


def _lenses(views: list[View]) -> str:
    bent = sum(view.image.lens is not None for view in views)
    return f"{bent} of {len(views)} views are straightened" if bent else "pinhole"


def _points(scene: Scene) -> str:
    sparse = scene.sparse
    if sparse is None:
        return "none"
    error = "" if sparse.errors is None else f", mean error {float(sparse.errors.mean()):.2f} px"
    return f"{len(sparse):,}{error}"


def _region(scene: Scene) -> str:
    region = scene.region
    if region is None:
        return "not said by the files"
    return f"radius {region.radius:.4g} about ({coordinates(region.center, region.radius)})"
