"""Rows of captures that leave pcore again: in another frame of the world, and as a mesh."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import torch
import trimesh
from torch import Tensor

import pcore
from benchmarks.capture_figures import Figure, Place, command, means, train
from pcore.asset.meshing import box_of, moved_mesh
from pcore.editing.script import parse_edit
from pcore.evaluation.ground_truth import load_truth
from pcore.gaussians.pinhole import surface_points
from pcore.geometry.camera import Camera
from pcore.geometry.surface_mesh import SurfaceMesh
from pcore.geometry.surface_search import SurfaceSearch
from pcore.render.fusion import DepthView, depth_view, fuse
from pcore.render.image import Image as Drawn

SPOT = "deformed/spot"
_VOXELS, _SAMPLES = 200, 20_000
"""Voxels along the mesh of the truth, and places on either mesh that are compared."""
_TWIST = {"version": 2, "edits": [{"type": "twist", "axis": "z", "angle_deg": 60}]}


def moved(place: Place) -> list[Figure]:
    """One capture, and the same moved, turned and scaled by 1000."""
    roots = {
        "here": copied(place.data / SPOT, place.folder / "here", torch.eye(4)),
        "there": copied(place.data / SPOT, place.folder / "there", similarity()),
    }
    runs = {name: place.folder / f"run-{name}" for name in roots}
    for name, root in roots.items():
        train(place, root, runs[name], 2)
    figures = [means(runs[name])["foreground_psnr"] for name in roots]
    gap = abs(figures[0] - figures[1])
    return [
        Figure(what="between here and there, object, dB", value=gap, bar=0.1, at_most=True),
        Figure(
            what="exported cameras there off the capture's own, share of their distance",
            value=exported_off(place, runs["there"], place.folder / "cameras"),
            bar=1e-5,
            at_most=True,
        ),
    ]


def similarity() -> Tensor:
    """(4, 4) float64 turn about an oblique axis, scale by 1000 and shift."""
    axis = torch.tensor([[0.0, -0.5, 0.3], [0.5, 0.0, -0.6], [-0.3, 0.6, 0.0]]).double()
    moved = torch.eye(4).double()
    moved[:3, :3] = 1000 * torch.linalg.matrix_exp(axis)
    moved[:3, 3] = torch.tensor([3000.0, -2000.0, 5000.0])
    return moved


def copied(scene: Path, folder: Path, there_from_here: Tensor) -> Path:
    """Copy the photos of a rendered scene with their cameras moved by a similarity (4, 4)."""
    shutil.rmtree(folder, ignore_errors=True)  # Of a call that was stopped.
    folder.mkdir(parents=True)
    scale = float(torch.linalg.det(there_from_here[:3, :3].double())) ** (1 / 3)
    for split in ("train", "test"):
        shutil.copytree(scene / split, folder / split)
        content = json.loads((scene / f"transforms_{split}.json").read_text())
        for frame in content["frames"]:
            pose = there_from_here.double() @ torch.tensor(frame["transform_matrix"]).double()
            pose[:3, :3] /= scale
            frame["transform_matrix"] = pose.tolist()
        (folder / f"transforms_{split}.json").write_text(json.dumps(content))
    return folder


def exported_off(place: Place, run: Path, folder: Path) -> float:
    """Largest difference of exported camera places from the scene's, by the cameras' distance."""
    command(place, "export", str(run), "--to", "cameras", "-o", str(folder), "--overwrite")
    frames = json.loads((folder / "transforms.json").read_text())["frames"]
    written = torch.tensor([one["transform_matrix"] for one in frames]).double()
    scene = pcore.load(run).scene()
    views = scene.split("train")
    own = torch.stack([view.camera.world_from_camera for view in views]).double()
    distance = float((own[:, :3, 3] - scene.center.double()).norm(dim=-1).mean())
    off = (written[:, :3, 3] - own[:, :3, 3]).norm(dim=-1) / distance
    turned = (written[:, :3, :3] - own[:, :3, :3]).abs().amax(dim=(1, 2))
    return float(torch.maximum(off, turned).max())


def mesh(place: Place) -> list[Figure]:
    """The mesh that exact depth gives against the true one, at rest and twisted."""
    scene, truth = pcore.load_scene(place.data / SPOT), load_truth(place.data / SPOT)
    points = torch.from_numpy(truth.canonical)
    views = [_seen(truth.depth(None, v.camera), v.camera) for v in scene.split("train")[::2]]
    lower, upper = box_of(points)
    voxel = float((upper - lower).max()) / _VOXELS
    vertices, faces = fuse(views, lower, upper, voxel)
    made = SurfaceMesh(vertices=vertices, faces=faces, colors=torch.zeros_like(vertices).float())
    colors = torch.zeros_like(points).float()
    true = SurfaceMesh(vertices=points, faces=torch.from_numpy(truth.faces), colors=colors)
    twist = parse_edit(_TWIST).bound(points).known
    pairs = {
        "at rest": (made, true),
        "twisted, against the twist of the true mesh": tuple(
            moved_mesh(one, twist) for one in (made, true)
        ),
    }
    return [
        Figure(what=f"Chamfer {name}, % of the size", value=chamfer(*two), bar=0.5, at_most=True)
        for name, two in pairs.items()
    ]


def _seen(depth: Tensor, camera: Camera) -> DepthView:
    """A picture of a true depth (H, W), grey."""
    depth = torch.where(depth.isfinite(), depth, torch.nan)
    alpha = depth.isfinite().float()
    rgb = 0.5 * alpha[..., None].expand(*alpha.shape, 3)
    surface = surface_points(depth, camera)
    return depth_view(Drawn(rgb=rgb, alpha=alpha, depth=depth, surface=surface), camera)


def chamfer(first: SurfaceMesh, second: SurfaceMesh) -> float:
    """Mean distance between two surfaces, mean of both directions, % of the second's diagonal."""
    off = [_off(first, second), _off(second, first)]
    size = float((second.vertices.amax(dim=0) - second.vertices.amin(dim=0)).norm())
    return 100 * sum(off) / 2 / size


def _off(own: SurfaceMesh, other: SurfaceMesh) -> float:
    body = trimesh.Trimesh(own.vertices.numpy(), own.faces.numpy(), process=False)
    places = trimesh.sample.sample_surface(body, _SAMPLES, seed=0)[0]
    search = SurfaceSearch(other.vertices.numpy(), other.faces.numpy())
    return float(search.closest(places).distance.mean())
