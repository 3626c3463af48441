import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.data.splat_files import columns_of, ply_bytes, read_plain
from tests.gaussians.some import some_gaussians

from pcore.data.gaussian_ply import gaussian_ply, read_gaussian_ply
from pcore.data.ply import parse_ply
from pcore.data.splat_file import SplatFile
from pcore.editing.gaussian_edit import edited_gaussians
from pcore.editing.script import EditScript, parse_edit
from pcore.errors import EditError
from pcore.gaussians.covariance import covariances
from pcore.gaussians.spherical_harmonics import basis

# Its ends lie beyond all points: there the map has a kink.
BEND = {"type": "bend", "axis": "x", "angle_deg": 120, "extent": [-3, 3]}
BOX = {"shape": "box", "lower": [-1, -1, -0.2], "upper": [1, 1, 2], "falloff": 0.5}


def script(*edits: dict, **more) -> EditScript:
    return parse_edit({"version": 2, "edits": list(edits), **more})


def file_of(count: int, **options) -> SplatFile:
    columns = columns_of(some_gaussians(count, dtype=torch.float64, **options))
    return read_gaussian_ply(parse_ply(ply_bytes(columns), "a.ply"), "a.ply")


def dense_maps(deformation, means: torch.Tensor, step: float = 1e-5) -> np.ndarray:
    """Jacobians (N, 3, 3) by differences."""
    columns = []
    for axis in torch.eye(3, dtype=torch.float64):
        there, back = deformation(means + step * axis), deformation(means - step * axis)
        columns.append(((there - back) / (2 * step)).numpy())
    return np.stack(columns, axis=2)


def sphere_points(count: int = 400) -> np.ndarray:
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, math.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


@pytest.mark.parametrize("edit", [BEND, {**BEND, "region": BOX}], ids=["whole", "region"])
def test_the_written_file_agrees_with_a_dense_reference(edit: dict):
    """Covariances and harmonics to 1e-5, Gaussian by Gaussian, in another way than pcore's."""
    file = file_of(60)
    own = file.gaussians
    edited = edited_gaussians(file, script(edit))
    written = read_gaussian_ply(parse_ply(gaussian_ply(edited.file), "b.ply"), "b.ply").gaussians
    deformation = script(edit).bind(own.means)
    maps = dense_maps(deformation, own.means)
    torch.testing.assert_close(written.means, deformation(own.means), atol=1e-6, rtol=1e-6)
    before, after = (covariances(g.quats, g.scales).numpy() for g in (own, written))
    seen = torch.from_numpy(sphere_points())
    for n in range(60):
        expected = maps[n] @ before[n] @ maps[n].T
        assert np.abs(after[n] - expected).max() < 1e-5 * np.abs(expected).max()
        left, _, right = np.linalg.svd(maps[n])
        turned = torch.from_numpy(np.ascontiguousarray(seen.numpy() @ (left @ right)))
        shown = basis(3, turned) @ own.sh[n].double()
        fitted = np.linalg.lstsq(basis(3, seen).numpy(), shown.numpy(), rcond=None)[0]
        assert np.abs(written.sh[n].numpy() - fitted).max() < 1e-5


def test_what_is_frozen_keeps_every_bit():
    file = file_of(80)
    region = {"shape": "half_space", "normal": [0, 0, -1], "origin": [0, 0, 0]}
    edited = edited_gaussians(file, script(BEND, freeze=[region]))
    rows = {False: read_plain(gaussian_ply(file)), True: read_plain(gaussian_ply(edited.file))}
    held = file.gaussians.means[:, 2].numpy() < -0.05
    for name in "xyz":
        assert (rows[True][name][held] == rows[False][name][held]).all()
    for name in ("f_dc_0", "f_rest_7", "scale_0", "opacity"):
        np.testing.assert_allclose(rows[True][name][held], rows[False][name][held], atol=1e-6)
    assert not np.allclose(rows[True]["f_rest_7"][~held], rows[False]["f_rest_7"][~held])


def test_far_off_places_lose_nothing():
    """A capture in the coordinates of a map: the same shapes as at the origin."""
    near = file_of(50)
    far = replace(near, gaussians=replace(near.gaussians, means=near.gaussians.means + 4e6))
    edits = [BEND, {**BEND, "origin": [4e6, 4e6, 4e6]}]
    moved = [
        edited_gaussians(file, script(edit)).file.gaussians
        for file, edit in zip((near, far), edits, strict=True)
    ]
    torch.testing.assert_close(moved[1].means - 4e6, moved[0].means, atol=1e-8, rtol=0)
    shapes = [covariances(g.quats, g.scales) for g in moved]
    torch.testing.assert_close(shapes[1], shapes[0], atol=1e-8, rtol=1e-6)


def test_folds_are_counted_or_refused():
    file = file_of(200)
    mirror = {"type": "taper", "axis": "z", "factor": -2.5}
    assert 0 < edited_gaussians(file, script(mirror)).folds.folded < 200
    with pytest.raises(EditError, match="inside out"):
        edited_gaussians(file, script(mirror), allow_folds=False)


def test_anchors_and_cages_carry_shapes(tmp_path: Path):
    import trimesh

    file = file_of(300)
    ball = trimesh.creation.icosphere(subdivisions=1, radius=3.0)
    stretch = np.diag([1.0, 1.0, 2.0])
    for name, vertices in (("before", ball.vertices), ("after", ball.vertices @ stretch)):
        trimesh.Trimesh(vertices, ball.faces, process=False).export(tmp_path / f"{name}.ply")
    cage = {"type": "cage", **{k: str(tmp_path / f"{k}.ply") for k in ("before", "after")}}
    moved = edited_gaussians(file, script(cage)).file.gaussians
    found = covariances(moved.quats, moved.scales)
    wide = torch.from_numpy(stretch)
    expected = wide @ covariances(file.gaussians.quats, file.gaussians.scales) @ wide
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-3)
    place = file.gaussians.means[0].tolist()
    drag = {"type": "anchors", "handles": [{"near": place, "to": [p + 0.2 for p in place]}]}
    moved = edited_gaussians(file, script(drag)).file.gaussians
    torch.testing.assert_close(moved.means[0], file.gaussians.means[0] + 0.2, atol=5e-3, rtol=0)


def test_those_that_bend_are_told_or_split():
    file = file_of(100)
    edited = edited_gaussians(file, script(BEND))
    assert 0 < edited.bent <= edited.looked_at == 100
    finer = edited_gaussians(file, script(BEND), split=0.3)
    assert finer.bent == 0
    assert finer.split == edited.bent
    assert len(finer.file.gaussians) > 100
    rows = read_plain(gaussian_ply(finer.file))
    source = read_plain(gaussian_ply(file))
    # What is not carried stays that of the one it was a part of.
    np.testing.assert_array_equal(rows["f_dc_1"], source["f_dc_1"][finer.file.rows])
