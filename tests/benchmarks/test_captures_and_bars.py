"""`python -m benchmarks captures`: rows are measured once, and their figures are right."""

import json
import math
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import pytest
import torch
import trimesh
from benchmarks.capture_exports import chamfer, copied, exported_off, similarity
from benchmarks.capture_figures import Figure, Place, means
from benchmarks.capture_rows import off_opencv

import capture_files
import tiny_scene
from benchmarks import captures
from pcore.capture.load import load_scene
from pcore.geometry.lens_distortion import LensDistortion
from pcore.geometry.surface_mesh import SurfaceMesh

BENT = ("OPENCV", capture_files.WIDTH, capture_files.HEIGHT, [30, 31, 12, 8, 0.1, -0.05, 0.01, 0])


def test_a_bar_is_kept_from_its_side_and_by_what_is_known() -> None:
    least, most = (Figure(what="", value=2, bar=2, at_most=side) for side in (False, True))
    assert least.kept
    assert most.kept
    assert not replace(least, value=1.9).kept
    assert not replace(most, value=2.1).kept
    assert not replace(most, value=math.nan).kept
    assert (least.bar_text, most.bar_text) == ("at least 2", "at most 2")


def test_rows_are_measured_once_and_one_that_fails_stops_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made: list[str] = []

    def lost(place: Place) -> list[Figure]:
        made.append("lost")
        return [Figure(what="views", value=len(load_scene(place.data).split("train")), bar=2)]

    def views(place: Place) -> list[Figure]:
        made.append("views")
        count = len(load_scene(place.data / "capture").split("train"))
        return [Figure(what="views", value=count, bar=8), Figure(what="more", value=count, bar=99)]

    capture_files.write_colmap(tmp_path / "data" / "capture")
    monkeypatch.setattr(captures, "ROWS", {"lost": lost, "views": views})
    wish = Namespace(
        data=tmp_path / "data", out=tmp_path / "out", only=["lost", "views"], threads=None
    )
    (tmp_path / "data" / "transforms_train.json").write_text("{}")
    assert captures.run(wish) == 1
    assert captures.run(wish) == 1
    assert made == ["lost", "views", "lost"]
    kept = json.loads((tmp_path / "out" / "views.json").read_text())
    assert kept["figures"][0]["value"] == 8
    text = (tmp_path / "out" / "captures.md").read_text()
    assert "| views | views | at least 8 | 8 | yes | " in text
    assert "| views | more | at least 99 | 8 | no |  |  |" in text
    said = capsys.readouterr()
    assert "lost: not measured: " in said.err
    assert "1 bars missed, 1 rows failed" in said.out


def test_lenses_are_held_against_opencv(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cv2")
    capture_files.write_colmap(tmp_path / "bent", cameras={1: BENT})
    capture_files.write_colmap(tmp_path / "straight")
    assert off_opencv(load_scene(tmp_path / "straight")) is None
    bent = off_opencv(load_scene(tmp_path / "bent"))
    assert bent is not None
    assert bent < 0.02
    wrong = LensDistortion.sources

    def shifted(self: LensDistortion, width: int, height: int) -> tuple[torch.Tensor, torch.Tensor]:
        places, valid = wrong(self, width, height)
        return places + 0.5, valid

    monkeypatch.setattr(LensDistortion, "sources", shifted)
    off = off_opencv(load_scene(tmp_path / "bent"))
    assert off == pytest.approx(0.5, abs=0.02)


def sphere(radius: float) -> SurfaceMesh:
    body = trimesh.creation.icosphere(4, radius)
    vertices = torch.from_numpy(body.vertices).double()
    faces = torch.tensor(body.faces.tolist())
    return SurfaceMesh(vertices=vertices, faces=faces, colors=torch.zeros_like(vertices).float())


def test_surfaces_are_as_far_apart_as_they_are() -> None:
    assert chamfer(sphere(1.0), sphere(1.0)) < 1e-4
    # Of the diagonal of the larger one's box, 2 * sqrt(3) * 1.02.
    assert chamfer(sphere(1.0), sphere(1.02)) == pytest.approx(100 * 0.02 / 3.533, rel=0.02)


def test_a_capture_elsewhere_is_the_same_and_its_cameras_come_back(tmp_path: Path) -> None:
    root = tiny_scene.write_scene(tmp_path / "scene", states=False)
    there = copied(root, tmp_path / "there", similarity())
    here, moved = load_scene(root), load_scene(there)
    camera, other = here.split("train")[1].camera, moved.split("train")[1].camera
    place = torch.tensor([0.2, -0.1, 0.3])
    motion = similarity().float()
    carried = motion[:3, :3] @ place + motion[:3, 3]
    torch.testing.assert_close(
        torch.stack(other.project(carried[None])[:2]),
        torch.stack(camera.project(place[None])[:2]),
        atol=1e-3,
        rtol=0,
    )
    run = tiny_scene.write_run(tmp_path / "run", there, factor=1)
    assert exported_off(Place(tmp_path, tmp_path), run, tmp_path / "cameras") < 1e-5
    assert math.isfinite(means(run)["foreground_psnr"])
    # Of a scene that is no more what it was the cameras are others.
    copied(root, there, torch.eye(4))
    written = (tmp_path / "cameras" / "transforms.json").read_bytes()
    exported_off(Place(tmp_path, tmp_path), run, tmp_path / "cameras")
    assert (tmp_path / "cameras" / "transforms.json").read_bytes() != written
