"""Mani-GS's binding: frames of triangles, and what a Gaussian on one does."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch
import trimesh

from pcore.errors import InputError
from pcore.gaussians.covariance import covariances
from pcore.gaussians.render import Footprint
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras
from pcore.render.image import Image
from pcore.rivals.bound_fit import BoundGaussians, sized_mesh
from pcore.rivals.mesh_bound import hung, placed, start_on, triangle_frames
from pcore.sample.sample_render import MeshCaster

VERTICES = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.1, 1.0]])
FACES = torch.tensor([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def bound() -> BoundGaussians:
    frames = triangle_frames(VERTICES, FACES)
    local = start_on(VERTICES, FACES, degree=1, opacity=0.5)
    torch.manual_seed(0)
    quats = torch.nn.functional.normalize(torch.randn(12, 4), dim=1)
    local = type(local)(
        **{**vars(local), "quats": quats, "scales": local.scales * (1 + torch.rand(12, 3))}
    )
    return BoundGaussians(
        vertices=VERTICES, faces=FACES, gaussians=placed(local, frames), footprint=Footprint()
    )


def test_frames_are_rotations_with_the_normal_first() -> None:
    frames = triangle_frames(VERTICES, FACES)
    eye = torch.eye(3).expand(4, 3, 3)
    torch.testing.assert_close(frames.rotations.mT @ frames.rotations, eye, atol=1e-6, rtol=0)
    torch.testing.assert_close(torch.linalg.det(frames.rotations), torch.ones(4))
    torch.testing.assert_close(frames.rotations[0, :, 0], torch.tensor([0.0, 0, -1]))
    # The first triangle: its first edge is 1 long, the others sqrt 2 and 1.
    b = (2**0.5 + 1) / 2
    torch.testing.assert_close(frames.sizes[0], 10 * torch.tensor([(b + 1) / 2, 1.0, b]))


def test_starts_at_the_published_places() -> None:
    frames = triangle_frames(VERTICES, FACES)
    means = placed(start_on(VERTICES, FACES, degree=0, opacity=0.5), frames).means
    corners = VERTICES[FACES[0]]
    expected = 0.5 * corners[0] + 0.25 * corners[1] + 0.25 * corners[2]
    torch.testing.assert_close(means[0], expected)


def test_hanging_and_placing_undo_each_other() -> None:
    one = bound()
    frames = triangle_frames(VERTICES, FACES)
    again = placed(hung(one.gaussians, frames), frames)
    torch.testing.assert_close(again.means, one.gaussians.means)
    torch.testing.assert_close(
        covariances(again.quats, again.scales),
        covariances(one.gaussians.quats, one.gaussians.scales),
        atol=1e-6,
        rtol=1e-4,
    )


def test_a_mesh_that_grows_grows_its_gaussians() -> None:
    one = bound()
    grown = one.carried(3 * VERTICES).gaussians
    torch.testing.assert_close(grown.means, 3 * one.gaussians.means, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(grown.scales, 3 * one.gaussians.scales)


def test_a_triangle_without_area_is_named() -> None:
    flat = VERTICES.clone()
    flat[3] = flat[1]
    with pytest.raises(InputError, match="an area in each, got none in 2 of 4"):
        bound().carried(flat)


def test_a_coarse_mesh_is_as_thick_as_its_object() -> None:
    # A ring whose tube is thinner than the distances that a coarse grid takes into account.
    ring = trimesh.creation.torus(0.7, 0.15)
    vertices, faces = np.asarray(ring.vertices), np.asarray(ring.faces)
    caster = MeshCaster(vertices, faces)

    def draw(camera: Camera) -> Image:
        rays = camera.rays()
        shape = rays.directions.shape[:-1]
        directions = rays.directions.reshape(-1, 3).double().numpy()
        ray, face, weights = caster.first_hits(camera.center.double().numpy(), directions)
        surface = torch.full((len(directions), 3), torch.nan)
        surface[ray] = torch.from_numpy(
            np.einsum("mi,mij->mj", weights, vertices[faces[face]])
        ).float()
        solid = surface[:, 0].isfinite()
        depth = ((surface - camera.center) @ -camera.world_from_camera[:3, 2]).reshape(shape)
        return Image(
            rgb=torch.zeros(*shape, 3),
            alpha=solid.float().reshape(shape),
            depth=depth,
            surface=surface.reshape(*shape, 3),
        )

    views = [
        SimpleNamespace(camera=camera)
        for height in (-1.2, -0.4, 0.4, 1.2)
        for camera in orbit_cameras(
            torch.zeros(3), 4.0, 8, elevation=height, width=60, height=60, angle_x=0.5
        )
    ]
    scene = cast("Any", SimpleNamespace(split=lambda name: views))
    grid, found, triangles = sized_mesh(draw, scene, torch.from_numpy(vertices), 800)
    assert grid.voxel > 0.07
    volume = trimesh.Trimesh(found.numpy(), triangles.numpy(), process=False).volume
    assert 0.75 * ring.volume < volume < 1.25 * ring.volume
