"""`pcore light` and what the other verbs make of the light of a run."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from toys import toy_cameras, toy_surfels, write_cameras, write_run, write_scene

import tiny_scene
from pcore.cli.main import main
from pcore.deform.base import Identity
from pcore.deform.pose import pose
from pcore.editing.script import load_edit
from pcore.files.model_file import describe_model
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.model.papr import Papr
from pcore.relight.lamps import Light, sphere
from pcore.relight.light_file import LIGHT_FILE, load_light, save_light
from pcore.relight.relighting import Relighting
from pcore.render.picture import render

TURN = {"version": 2, "edits": [{"type": "rigid", "axis": "x", "angle_deg": 120}]}


def lamp_from_above() -> Light:
    directions = sphere(40)
    return Light(
        directions=directions,
        radiance=0.1 + (4 * directions[:, 2] - 2).exp(),
        nearness=torch.zeros(40),
        center=torch.zeros(3),
    )


def write_light(run: Path, cloud: PointCloud) -> Relighting:
    """A light from above; the points lie on a ball, which says how they face."""
    positions = cloud.positions.detach()
    bright = torch.full((len(positions),), 0.3)
    light = Relighting.of(lamp_from_above(), positions, toy_surfels(positions), bright)
    save_light(run / LIGHT_FILE, light)
    return light


@pytest.fixture
def made(tmp_path: Path) -> tuple[Path, Papr, PointCloud, Relighting]:
    papr, cloud = write_run(tmp_path / "run", surfels=True)
    return tmp_path / "run", papr, cloud, write_light(tmp_path / "run", cloud)


def picture_of(run: Path, tmp_path: Path, *options: str, what: str = "rgb") -> np.ndarray:
    (tmp_path / "turn.json").write_text(json.dumps(TURN))
    cameras = write_cameras(tmp_path / "cameras.json", toy_cameras(1, size=8), w=8, h=8)
    words = ["render", run, "--cameras", cameras, "--raw", "--overwrite", "-o", tmp_path / "out"]
    assert main([*map(str, words), *options]) == 0
    return np.load(tmp_path / "out" / "r_0.npz")[what]


@pytest.mark.parametrize(
    ("options", "aware", "lit"),
    [
        ((), True, True),
        (("--light", "still"), True, True),
        (("--light", "baked"), True, False),
        (("--rays", "plain"), False, False),
        (("--rays", "plain", "--light", "still"), False, True),
    ],
)
def test_a_light_stands_still_unless_asked_otherwise(
    made: tuple[Path, Papr, PointCloud, Relighting],
    tmp_path: Path,
    options: tuple[str, ...],
    aware: bool,
    lit: bool,
) -> None:
    run, papr, cloud, light = made
    found = picture_of(run, tmp_path, "--edit", str(tmp_path / "turn.json"), *options)
    deformation = load_edit(tmp_path / "turn.json").bind(cloud.positions)
    dark = pose(cloud, deformation, surfels=toy_surfels(cloud.positions), aware=aware)
    bright = replace(dark, gains=light.gains(dark))
    expected, other = (
        render(papr, one, toy_cameras(1, size=8)[0]).rgb.numpy()
        for one in ((bright, dark) if lit else (dark, bright))
    )
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert np.abs(expected - other).max() > 0.02


def test_pictures_are_as_deep_as_the_surface_whatever_the_light(
    made: tuple[Path, Papr, PointCloud, Relighting], tmp_path: Path
) -> None:
    run, papr, cloud, _ = made
    camera, surfels = toy_cameras(1, size=8)[0], toy_surfels(cloud.positions)
    bare = render(papr, PosedCloud.at_rest(cloud), camera)
    covered = render(papr, PosedCloud.at_rest(cloud, surfels), camera)
    met = torch.isfinite(bare.depth)
    assert float((covered.depth - bare.depth)[met].abs().max()) > 0.05
    np.testing.assert_allclose(picture_of(run, tmp_path), bare.rgb.numpy(), atol=1e-6)
    for options in ((), ("--light", "still"), ("--light", "baked"), ("--rays", "plain")):
        found = picture_of(run, tmp_path, *options, what="depth")
        np.testing.assert_allclose(found, covered.depth.numpy(), atol=1e-5)


def test_an_edit_that_moves_nothing_is_as_deep_as_none(
    made: tuple[Path, Papr, PointCloud, Relighting],
) -> None:
    _, papr, cloud, _ = made
    surfels, camera = toy_surfels(cloud.positions), toy_cameras(1, size=8)[0]
    still = pose(cloud, Identity(), surfels=surfels)
    found, expected = (
        render(papr, one, camera) for one in (still, PosedCloud.at_rest(cloud, surfels))
    )
    torch.testing.assert_close(found.depth, expected.depth, rtol=0, atol=0, equal_nan=True)
    assert torch.equal(found.rgb, expected.rgb)
    assert pose(cloud, Identity()).surfels is None


def test_a_light_that_cannot_be_read_can_be_done_without(
    made: tuple[Path, Papr, PointCloud, Relighting],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run, _, _, light = made
    save_light(run / LIGHT_FILE, replace(light, positions=light.positions + 1))
    assert main(["render", str(run), "--orbit", "2", "-o", str(tmp_path / "film")]) == 2
    assert "`pcore light RUN`" in capsys.readouterr().err
    picture_of(run, tmp_path, "--light", "baked")


def test_a_light_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_run(tmp_path / "run")
    edit = ("--edit", str(tmp_path / "turn.json"))
    picture_of(tmp_path / "run", tmp_path, *edit)
    words = ["render", str(tmp_path / "run"), "--orbit", "2", *edit, "--light", "still"]
    assert main(words) == 2
    assert "expected a light.safetensors in the folder of the run" in capsys.readouterr().err


@pytest.mark.parametrize("verb", ["render", "animate", "eval"])
def test_rays_per_pixel_are_checked_first(
    made: tuple[Path, Papr, PointCloud, Relighting],
    tmp_path: Path,
    verb: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = {
        "render": ["-o", str(tmp_path / "out")],
        "animate": ["--edit", "no.json", "-o", str(tmp_path / "out.mp4")],
        "eval": ["-o", str(tmp_path / "out")],
    }
    assert main([verb, str(made[0]), *words[verb], "--samples", "3"]) == 2
    assert "--samples: expected rays per pixel that make a square" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_info_tells_of_the_light(
    made: tuple[Path, Papr, PointCloud, Relighting], capsys: pytest.CaptureFixture[str]
) -> None:
    run, _, _, light = made
    assert main(["info", str(run)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "brightest on surfaces that face" in said
    assert "lamps are far away" in said
    size = float((light.positions.amax(dim=0) - light.positions.amin(dim=0)).norm())
    near = replace(light.light, nearness=torch.full((40,), 1 / (2.5 * size)))
    save_light(run / LIGHT_FILE, replace(light, light=near))
    assert main(["info", str(run)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "lamps are 2.5 times the object's size away" in said
    save_light(run / LIGHT_FILE, replace(light, positions=light.positions + 1))
    assert main(["info", str(run)]) == 0, "a stale light is no reason to say nothing"
    assert "cannot be used" in " ".join(capsys.readouterr().out.split())


def test_the_light_of_other_points_is_an_error(
    made: tuple[Path, Papr, PointCloud, Relighting], capsys: pytest.CaptureFixture[str]
) -> None:
    run, _, _, light = made
    save_light(run / LIGHT_FILE, replace(light, positions=light.positions + 1))
    edit = run / "turn.json"
    edit.write_text(json.dumps(TURN))
    assert main(["render", str(run), "--orbit", "2", "--edit", str(edit)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "points that the light was estimated with" in said


def test_a_random_run_has_no_normals_to_speak_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_scene(tmp_path / "scene")
    write_run(tmp_path / "run", scene="../scene")
    assert main(["light", str(tmp_path / "run")]) == 2
    said = capsys.readouterr()
    assert "at least 50 points with a normal" in " ".join(said.err.split())
    assert not (tmp_path / "run" / LIGHT_FILE).exists()
    # What was not known of the surface is kept all the same.
    model = tmp_path / "run" / "model.safetensors"
    assert f"{model}: the surface over the points was not known; estimated now" in said.out
    assert describe_model(model).surfels
    assert main(["light", str(tmp_path / "run")]) == 2
    assert "estimated now" not in capsys.readouterr().out


def test_an_evaluation_shows_pictures_with_the_light_and_without(tmp_path: Path) -> None:
    scene = tiny_scene.write_scene(tmp_path / "box")
    run = tiny_scene.write_run(tmp_path / "run", scene, surfels=True)
    from pcore.files.model_file import load_model

    saved = load_model(run)
    cloud, surfels = saved.cloud, saved.surfels
    assert surfels is not None
    bright = torch.full((len(cloud),), 0.3)
    light = Relighting.of(lamp_from_above(), cloud.positions, surfels, bright)
    save_light(run / LIGHT_FILE, light)
    assert main(["eval", str(run), "--protocol", "standard"]) == 0
    with (run / "eval" / "images.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(dict.fromkeys(row["method"] for row in rows)) == ["PAPR", "aware", "aware + light"]
    psnr = {
        (row["state"], row["method"]): float(row["psnr"]) for row in rows if row["view"] == "r_0"
    }
    assert psnr["canonical", "aware + light"] == psnr["canonical", "aware"]
    assert psnr["grown", "aware + light"] == pytest.approx(psnr["grown", "aware"], abs=1e-3)
    assert psnr["walk", "aware + light"] != psnr["walk", "aware"], "a shear turns normals"
    deep = {(row["state"], row["view"], row["method"]): row["depth_error"] for row in rows}
    for state, view, method in list(deep):
        if method == "aware + light":
            assert deep[state, view, method] == deep[state, view, "aware"], "one kind of depth"
    near = replace(light.light, nearness=torch.full((40,), 0.2))
    save_light(run / LIGHT_FILE, Relighting.of(near, cloud.positions, surfels, bright))
    words = ["eval", str(run), "--protocol", "standard", "--state", "scale:2", "grown"]
    assert main([*words, "-o", str(tmp_path / "near")]) == 0
    with (tmp_path / "near" / "images.csv").open(newline="") as file:
        near_rows = list(csv.DictReader(file))
    psnr = {
        (row["state"], row["method"]): float(row["psnr"])
        for row in near_rows
        if row["view"] == "r_0"
    }
    assert psnr["scale:2", "aware + light"] == pytest.approx(psnr["scale:2", "aware"], abs=1e-3)
    assert psnr["grown", "aware + light"] != pytest.approx(psnr["grown", "aware"], abs=1e-3)
    assert main(["eval", str(run), "--light", "baked", "-o", str(tmp_path / "baked")]) == 0
    assert "aware + light" not in (tmp_path / "baked" / "images.csv").read_text()
    light = load_light(run, cloud.positions)
    save_light(run / LIGHT_FILE, replace(light, positions=light.positions + 1))
    assert main(["eval", str(run), "--rays", "plain"]) == 0, "plain rays ask for no light"
    assert main(["eval", str(run)]) == 2
