"""Voxels: what is between corners, what rays see, and the way back through a cage."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

import tiny_scene
from pcore.capture.load import load_scene
from pcore.deform.cage import Cage
from pcore.errors import InputError
from pcore.evaluation.protocol import STANDARD, measure
from pcore.geometry.orbit import orbit_cameras
from pcore.render.fusion import depth_view, fused_distances
from pcore.rivals.cage_mesh import coarse_cage, largest_piece
from pcore.rivals.voxel_fit import VoxelConfig, fit_voxels, hull_grid
from pcore.rivals.voxels import VoxelField, VoxelGrid, cage_warp

SIDE, STEP = 9, 0.25


def block(density: float) -> VoxelField:
    """A red block from -0.5 to 0.5 in a grid from -1 to 1."""
    axis = -1 + STEP * torch.arange(SIDE)
    corners = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), dim=-1)
    inside = (corners.abs() <= 0.5).all(dim=-1)
    index = torch.full(inside.shape, int(inside.sum()))
    index[inside] = torch.arange(int(inside.sum()))
    values = torch.zeros(int(inside.sum()) + 1, 28)
    values[:-1, 0] = density
    values[:-1, 1:4] = torch.tensor([1.0, -2.0, -2.0]) / 0.28209479
    return VoxelField(grid=VoxelGrid(index=index, lower=corners[0, 0, 0], step=STEP), values=values)


def camera(size: int = 24):
    return orbit_cameras(
        torch.zeros(3), 4.0, 3, elevation=0.0, width=size, height=size, angle_x=0.6
    )[0]


def test_values_are_linear_between_corners() -> None:
    field = block(4.0)
    points = torch.tensor([[0.1, 0.2, -0.3], [0.5, 0, 0], [0.625, 0, 0], [0.75, 0, 0]])
    found = field.grid.at(field.values, points)[:, 0]
    torch.testing.assert_close(found, torch.tensor([4.0, 4.0, 2.0, 0.0]))


def test_a_block_is_seen_where_it_is() -> None:
    seen = block(50.0).draw(camera())
    middle = (12, 12)
    assert float(seen.alpha[middle]) > 0.99
    assert float(seen.alpha[0, 0]) == 0
    red, green, blue = seen.rgb[middle].tolist()
    assert red > 0.9
    assert max(green, blue) < 0.1
    # From 4 away the near face is 3.5 away, and fades out within a voxel before it.
    assert abs(float(seen.depth[middle]) - 3.4) < STEP
    torch.testing.assert_close(seen.rgb[0, 0], torch.ones(3))


def test_the_way_back_through_a_cage() -> None:
    corner = torch.tensor([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    warp = cage_warp(corner, torch.tensor(faces), 2 * corner + 1)
    points = torch.tensor([[1.0, 1.0, 1.0], [0.0, 2.0, 0.6], [5.0, 0, 0]])
    back, held = warp(points)
    assert held.tolist() == [True, True, False]
    torch.testing.assert_close(back[:2], (points[:2] - 1) / 2, atol=1e-4, rtol=0)
    # Twice as large, and as far away twice: the same picture.
    far = camera()
    pose = far.world_from_camera.clone()
    pose[:3, 3] = 2 * pose[:3, 3] + 1
    one = block(50.0)
    torch.testing.assert_close(
        one.draw(far.moved(pose), warp).alpha[12, 12],
        one.draw(far).alpha[12, 12],
        atol=0.02,
        rtol=0,
    )


def test_depth_becomes_a_closed_mesh_and_a_cage_around_it() -> None:
    field = block(50.0)
    cameras = orbit_cameras(
        torch.zeros(3), 4.0, 10, elevation=0.6, width=40, height=40, angle_x=0.6
    ) + orbit_cameras(torch.zeros(3), 4.0, 10, elevation=-0.6, width=40, height=40, angle_x=0.6)
    corner = torch.full((3,), 0.7)
    views = [depth_view(field.draw(camera), camera) for camera in cameras]
    fused = fused_distances(views, -corner, corner, 1.4 / 20, smooth=0.0, closed=True)
    vertices, faces = largest_piece(fused)
    Cage(vertices=vertices, faces=faces)  # Closed, or it says why not.
    reach = vertices.abs().amax(dim=1)
    assert 0.45 < float(reach.median()) < 0.7
    around = Cage(**dict(zip(("vertices", "faces"), coarse_cage(fused), strict=True)))
    assert bool(around.holds(vertices).all())


def test_a_field_learns_its_photos(tmp_path: Path) -> None:
    scene = load_scene(tiny_scene.write_scene(tmp_path / "box", states=False))
    field = fit_voxels(scene, VoxelConfig(cells=10, steps=100, rays=300))
    view = scene.split("train")[0]
    with torch.no_grad():
        seen = field.draw(view.camera)
    scores = measure(STANDARD, seen.rgb, view.rgba())
    assert scores.psnr > 18  # A white picture has 10.
    # Time ends a training before its steps do.
    begin = time.process_time()
    fit_voxels(scene, VoxelConfig(cells=10, steps=100_000, rays=100), seconds=0.3)
    assert time.process_time() - begin < 10


def test_masks_are_needed_and_must_meet(tmp_path: Path) -> None:
    scene = load_scene(tiny_scene.write_scene(tmp_path / "box", states=False))
    view = scene.split("train")[0]

    def masked(alpha: torch.Tensor, has_alpha: bool = True) -> Any:
        return SimpleNamespace(camera=view.camera, alpha=lambda: alpha, has_alpha=has_alpha)

    with pytest.raises(InputError, match="the masks have nothing in common"):
        hull_grid(scene, [masked(torch.zeros(24, 24))], 10)
    with pytest.raises(InputError, match="expected photos with masks for a voxel field"):
        hull_grid(scene, [view, masked(torch.ones(24, 24), has_alpha=False)], 10)
