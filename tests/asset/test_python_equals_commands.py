"""Law: what Python draws of a run is what the commands draw of it, to the last bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from tests.cli.toys import toy_cameras, write_cameras
from tests.seeded_runs import RUNS, write_edits, write_moving_edit, write_runs
from torch import Tensor

import pcore
from pcore.asset.asset import How
from pcore.asset.content import LightName, RaysName
from pcore.cli.main import main
from pcore.data.points import load_points
from pcore.data.video import VideoWriter
from pcore.geometry.camera_path import path_through

FIELDS = ("rgb", "alpha", "depth", "surface")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return write_runs(tmp_path_factory.mktemp("runs"))


@pytest.fixture(scope="module")
def edits(runs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return write_edits(tmp_path_factory.mktemp("edits"), runs)


def call(*words: object) -> None:
    assert main([*map(str, words), "--device", "cpu"]) == 0


def assert_pictures_of(folder: Path, pictures: list[object]) -> None:
    files = sorted(folder.glob("*.npz"))
    assert len(files) == len(pictures) > 0
    for file, picture in zip(files, pictures, strict=True):
        with np.load(file) as raw:
            for name in FIELDS:
                np.testing.assert_array_equal(raw[name], getattr(picture, name).numpy())


@pytest.mark.parametrize("name", RUNS)
@pytest.mark.parametrize("edited", [True, False])
@pytest.mark.parametrize(("rays", "light"), [("aware", None), ("plain", None), ("aware", "baked")])
def test_render(
    runs: dict[str, Path],
    edits: dict[str, Path],
    tmp_path: Path,
    name: str,
    edited: bool,
    rays: RaysName,
    light: LightName | None,
) -> None:
    words = ["--rays", rays, *(["--light", light] if light else [])]
    words += ["--edit", str(edits[name])] if edited else []
    call("render", runs[name], "--split", "test", "--raw", "-o", tmp_path / "out", *words)
    asset = pcore.load(runs[name])
    posed = asset.pose(edits[name] if edited else None, rays=rays, light=light)
    cameras = [view.camera for view in asset.scene().split("test")]
    assert_pictures_of(tmp_path / "out", list(asset.render(posed, cameras)))


@pytest.mark.parametrize("name", RUNS)
def test_what_a_run_has_shows(runs: dict[str, Path], edits: dict[str, Path], name: str) -> None:
    """A law about a light that nobody uses would be no law."""
    asset = pcore.load(runs[name])
    camera = asset.scene().split("test")[0].camera
    drawn = asset.render(asset.pose(edits[name]), camera).rgb
    if name == "lit":
        other = asset.render(asset.pose(edits[name], light="baked"), camera).rgb
    elif name == "rigged":
        script = pcore.load_edit(edits[name])
        other = asset.render(asset.pose(script.bind(asset.points)), camera).rgb
    else:
        other = asset.render(None, camera).rgb
    assert float((drawn - other).abs().max()) > 1e-3


@pytest.mark.parametrize("options", [{"fast": True}, {"samples": 4}])
def test_how_pictures_are_sampled(runs: dict[str, Path], tmp_path: Path, options: How) -> None:
    words = ["--fast"] if "fast" in options else ["--samples", "4"]
    call("render", runs["lit"], "--split", "test", "--raw", "-o", tmp_path / "out", *words)
    asset = pcore.load(runs["lit"])
    cameras = [view.camera for view in asset.scene().split("test")]
    assert_pictures_of(tmp_path / "out", list(asset.render(None, cameras, **options)))


def test_an_orbit_without_a_scene(
    runs: dict[str, Path], edits: dict[str, Path], tmp_path: Path
) -> None:
    """The frames of a film share how they are sampled."""
    model = runs["plain"] / "model.safetensors"
    words = ("--orbit", 3, "--raw", "--edit", edits["plain"], "--size", 12, 8)
    call("render", model, *words, "-o", tmp_path / "out")
    asset = pcore.load(model)
    posed = asset.pose(edits["plain"])
    cameras = pcore.orbit_around(posed.points, 3, size=(12, 8))
    assert_pictures_of(tmp_path / "out", list(asset.film([posed] * 3, cameras)))


@pytest.mark.parametrize("name", ["lit", "rigged"])
def test_animate(
    runs: dict[str, Path], tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames: list[Tensor] = []
    add = VideoWriter.add

    def note(self: VideoWriter, frame: Tensor) -> None:
        frames.append(frame.clone())
        add(self, frame)

    monkeypatch.setattr(VideoWriter, "add", note)
    path = write_cameras(tmp_path / "cameras.json", toy_cameras(2, size=10), w=10, h=10)
    moving, points = write_moving_edit(tmp_path / "moving.json"), tmp_path / "points"
    words = ("--cameras", path, "--frames", 3, "-o", tmp_path / "out.mp4", "--points", points)
    call("animate", runs[name], "--edit", moving, *words)
    asset = pcore.load(runs[name])
    moved = [asset.pose(moving, time=time) for time in (0.0, 0.5, 1.0)]
    cameras = path_through([camera for _, camera in pcore.load_cameras(path)], 3)
    for own, picture in zip(frames, asset.film(moved, cameras), strict=True):
        assert torch.equal(own, picture.rgb)
    for number, posed in enumerate(moved):
        assert torch.equal(load_points(points / f"frame_{number:03}.ply"), posed.points)


@pytest.mark.parametrize("name", RUNS)
def test_a_session_is_the_edit_file_that_it_saves(
    runs: dict[str, Path], edits: dict[str, Path], tmp_path: Path, name: str
) -> None:
    asset = pcore.load(runs[name])
    session = asset.session(edits[name])
    session.do({"type": "taper", "axis": "z", "factor": 0.3})
    session.save(tmp_path / "saved.json")
    camera = asset.scene().split("test")[0].camera
    drawn, again = (asset.pose(one) for one in (session, tmp_path / "saved.json"))
    assert torch.equal(drawn.points, session.state.points)
    assert torch.equal(asset.render(drawn, camera).rgb, asset.render(again, camera).rgb)
    session.undo()
    before = asset.render(asset.pose(session.state), camera).rgb
    assert torch.equal(before, asset.render(asset.pose(edits[name]), camera).rgb)
