"""A run of a ball of Gaussians, and its bundle for Blender."""

import json
from pathlib import Path

from gaussian_ball import ball_run
from pcore.asset import meshing
from pcore.asset.blender_bundle import save_bundle
from pcore.asset.saving import load
from pcore.cli.cameras import OrbitWish, orbit_of_cloud


def ball_bundle(root: Path) -> Path:
    asset = load(ball_run(root / "ball"))
    folder = root / "bundle"
    folder.mkdir()
    views = meshing._VIEWS
    meshing._VIEWS = 12
    try:
        cameras = orbit_of_cloud(asset.points, OrbitWish(count=12, size=(120, 90)))
        save_bundle(folder, asset, cameras, resolution=32)
    finally:
        meshing._VIEWS = views
    # As of a capture whose world lies: its -y was up.
    path = folder / "bundle.json"
    about = json.loads(path.read_text()) | {"axes": [[1, 0, 0], [0, 0, -1], [0, 1, 0]]}
    path.write_text(json.dumps(about))
    return folder
