"""The law of the user's frame: an object elsewhere, turned, in other units, exports the same there.

Nothing is trained twice: the Gaussians themselves are moved, and what is written of both is held
against one another, in parts of the object's size.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray
from rich.console import Console
from tests.cli.toys import write_cameras

from gaussian_ball import ball_run
from pcore.asset import meshing
from pcore.cli.export import ExportCommand, export
from pcore.data.splat_formats import read_splats
from pcore.files.gaussian_file import load_gaussians, save_gaussians
from pcore.gaussians.carry import carried
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras
from room_scene import moved_camera, similarity

BAR = 1e-5
SIZE = 1.6


@pytest.fixture(autouse=True)
def _few_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(meshing, "_VIEWS", 16)


def moved(places: NDArray[np.float64]) -> NDArray[np.float64]:
    turn, shift, scale = similarity()
    return scale * places @ turn.double().numpy().T + shift.double().numpy()


def moved_run(folder: Path, motion: tuple[torch.Tensor, torch.Tensor, float]) -> Path:
    """The ball of `ball_run` under a similarity."""
    turn, shift, scale = motion
    run = ball_run(folder)
    saved = load_gaussians(run)
    means = scale * saved.gaussians.means.double() @ turn.double().T + shift.double()
    maps = (scale * turn).expand(len(means), 3, 3)
    there = carried(saved.gaussians, means.float(), maps)
    corners = torch.stack([means.amin(dim=0), means.amax(dim=0)])
    extent = (tuple(corners[0].tolist()), tuple(corners[1].tolist()))
    provenance = replace(saved.provenance, extent=extent)
    save_gaussians(
        run / "gaussians.safetensors", replace(saved, gaussians=there, provenance=provenance)
    )
    return run


def made(run: Path, to: str, output: Path, **options: object) -> Path:
    command = ExportCommand(
        run_folder=run, to=to, output=output, threads=1, device="cpu", **options
    )
    export(command, Console(quiet=True))
    return output


def ring(there: bool) -> list[Camera]:
    around = orbit_cameras(torch.zeros(3), 4.0, 6, elevation=0.3, width=24, height=24, angle_x=0.6)
    return [moved_camera(one, similarity()) for one in around] if there else around


def test_points_splats_and_cameras(tmp_path: Path) -> None:
    runs = [ball_run(tmp_path / "here"), moved_run(tmp_path / "there", similarity())]
    size = SIZE * similarity()[2]
    points = [
        np.asarray(trimesh.load(made(run, "ply", run.with_suffix(".ply"))).vertices, np.float64)
        for run in runs
    ]
    assert np.abs(moved(points[0]) - points[1]).max() < BAR * size
    splats = [
        read_splats(made(run, "splats", run.with_name(f"{run.name}-splats.ply"))).gaussians
        for run in runs
    ]
    assert np.abs(moved(splats[0].means.double().numpy()) - splats[1].means.numpy()).max() < (
        BAR * size
    )
    longest = [one.scales.amax(dim=1).double() for one in splats]
    assert float((similarity()[2] * longest[0] - longest[1]).abs().max()) < BAR * size
    # Cameras that look from the same side see the same, and are written where they stand.
    centers: list[NDArray[np.float64]] = []
    for run, there in zip(runs, (False, True), strict=True):
        named = write_cameras(tmp_path / f"{there}.json", ring(there), w=24, h=24)
        out = made(run, "cameras", run.with_name(f"{run.name}-cameras"), cameras=named)
        lines = (out / "colmap/sparse/0/images.txt").read_text().splitlines()
        rows = [line.split() for line in lines if line and not line.startswith("#")]
        poses = [[float(x) for x in row[1:8]] for row in rows if len(row) >= 9]
        centers.append(np.array([center(pose) for pose in poses]))
    assert len(centers[0]) == 6
    assert np.abs(moved(centers[0]) - centers[1]).max() < BAR * size


def center(pose: list[float]) -> NDArray[np.float64]:
    """Of a camera as COLMAP writes it: quaternion w x y z and translation, camera from world."""
    from scipy.spatial.transform import Rotation

    w, x, y, z, *shift = pose
    return -Rotation.from_quat([x, y, z, w]).as_matrix().T @ np.array(shift)


def test_meshes(tmp_path: Path) -> None:
    """The grid of voxels is not turned along, so the unit alone changes; 1024 rounds nothing."""
    motion = torch.eye(3), torch.zeros(3), 1024.0
    runs = [ball_run(tmp_path / "here"), moved_run(tmp_path / "there", motion)]
    pytest.importorskip("skimage", reason="the extra mesh is not installed")
    here, there = (
        trimesh.load(made(run, "mesh", run.with_suffix(".ply"), resolution=40)) for run in runs
    )
    assert here.vertices.shape == there.vertices.shape
    assert np.abs(1024 * here.vertices - there.vertices).max() < BAR * SIZE * 1024
